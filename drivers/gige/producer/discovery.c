#include "discovery.h"

#include <arpa/inet.h>
#include <errno.h>
#include <ifaddrs.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "answer.h"
#include "gvcp.h"
#include "wire.h"

enum { MIN_WAIT_MS = 100, MAX_WAIT_MS = 1000, PROBES = 3 };
enum { DISCOVERY_SIZE = 0xf8, DATAGRAM_SIZE = 1500 };

/* Read "A.B.C.D" or "A.B.C.D:PORT". */
static bool parse_camera_address(const char *entry, struct route *route)
{
    char host[32];
    snprintf(host, sizeof host, "%s", entry);
    unsigned long port = GVCP_PORT;
    char *colon = strchr(host, ':');
    if (colon) {
        char *end;
        *colon = '\0';
        port = strtoul(colon + 1, &end, 10);
        if (end == colon + 1 || *end || port < 1 || port > 65535)
            return false;
    }
    route->target = (struct sockaddr_in){.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    return inet_pton(AF_INET, host, &route->target.sin_addr) == 1;
}

/* An interface by its name: the loopback one is asked at its own address, another by the broadcast
 * of its own subnet. */
static bool find_interface(const char *entry, struct route *route)
{
    struct ifaddrs *all, *one;
    if (getifaddrs(&all))
        return false;
    for (one = all; one; one = one->ifa_next)
        if (one->ifa_addr && one->ifa_addr->sa_family == AF_INET && one->ifa_netmask &&
            (one->ifa_flags & IFF_UP) && !strcmp(one->ifa_name, entry))
            break;
    if (one) {
        route->from = ((struct sockaddr_in *)one->ifa_addr)->sin_addr;
        route->target = (struct sockaddr_in){
            .sin_family = AF_INET, .sin_port = htons(GVCP_PORT), .sin_addr = route->from};
        route->is_broadcast = !(one->ifa_flags & IFF_LOOPBACK);
        if (route->is_broadcast)
            route->target.sin_addr.s_addr |=
                ~((struct sockaddr_in *)one->ifa_netmask)->sin_addr.s_addr;
    }
    freeifaddrs(all);
    return one != NULL;
}

GC_ERROR routes_parse(const char *list, struct route *routes, size_t *n_routes)
{
    *n_routes = 0;
    for (const char *entry = list; entry; entry = strchr(entry, ',')) {
        entry += *entry == ',';
        entry += strspn(entry, " ");
        size_t size = strcspn(entry, ", ");
        if (size == 0)
            continue;
        if (*n_routes == MAX_ROUTES)
            return fail(GC_ERR_INVALID_PARAMETER, ROUTES_VARIABLE ": more than %d entries",
                        MAX_ROUTES);
        struct route *route = &routes[*n_routes];
        *route = (struct route){0};
        if (size >= sizeof route->name)
            return fail(GC_ERR_INVALID_PARAMETER, ROUTES_VARIABLE ": '%.*s' is too long",
                        (int)size, entry);
        memcpy(route->name, entry, size);
        if (!parse_camera_address(route->name, route) && !find_interface(route->name, route))
            return fail(GC_ERR_INVALID_PARAMETER,
                        ROUTES_VARIABLE ": '%s' is neither a network interface that is up with "
                                        "an IPv4 address, nor a camera's address A.B.C.D[:PORT]",
                        route->name);
        ++*n_routes;
    }
    return GC_ERR_SUCCESS;
}

static void copy_text(char *text, const uint8_t *bytes, size_t size)
{
    memcpy(text, bytes, size);
    text[size] = '\0';
}

bool camera_parse(const uint8_t *payload, size_t size, const struct sockaddr_in *from,
                  struct camera *camera)
{
    if (size < DISCOVERY_SIZE)
        return false;
    *camera = (struct camera){.address = *from};
    camera->mac = (uint64_t)load16(payload + 0x0a) << 32 | load32(payload + 0x0c);
    copy_text(camera->vendor, payload + 0x48, 32);
    copy_text(camera->model, payload + 0x68, 32);
    copy_text(camera->version, payload + 0x88, 32);
    copy_text(camera->serial, payload + 0xd8, 16);
    copy_text(camera->user_name, payload + 0xe8, 16);

    char name[17], host[INET_ADDRSTRLEN];
    snprintf(name, sizeof name, "%012llx", (unsigned long long)camera->mac);
    inet_ntop(AF_INET, &from->sin_addr, host, sizeof host);
    snprintf(camera->id, sizeof camera->id, "%s@%s:%u",
             camera->serial[0] ? camera->serial : name, host, ntohs(from->sin_port));
    return true;
}

static bool is_known(const struct camera *cameras, size_t n_cameras, const struct camera *camera)
{
    for (size_t i = 0; i < n_cameras; i++)
        if (!strcmp(cameras[i].id, camera->id))
            return true;
    return false;
}

/* Take in answers until the time is up; true if the route's only camera has answered. */
static bool collect(int fd, const struct route *route, uint64_t end_us, struct camera *cameras,
                    size_t *n_cameras)
{
    for (uint64_t now = clock_us(); now < end_us; now = clock_us()) {
        struct pollfd readable = {.fd = fd, .events = POLLIN};
        if (poll(&readable, 1, (int)((end_us - now) / 1000 + 1)) <= 0)
            continue;
        uint8_t bytes[DATAGRAM_SIZE];
        struct sockaddr_in from;
        socklen_t from_size = sizeof from;
        ssize_t size =
            recvfrom(fd, bytes, sizeof bytes, 0, (struct sockaddr *)&from, &from_size);
        struct gvcp_ack ack;
        struct camera camera;
        if (size < 0 || !gvcp_parse_ack(bytes, (size_t)size, &ack) || ack.status != 0 ||
            ack.command != GVCP_DISCOVERY_ACK ||
            !camera_parse(ack.payload, ack.payload_size, &from, &camera))
            continue;
        if (*n_cameras < MAX_CAMERAS && !is_known(cameras, *n_cameras, &camera))
            cameras[(*n_cameras)++] = camera;
        if (!route->is_broadcast)
            return true;
    }
    return false;
}

GC_ERROR discover(const struct route *route, uint64_t timeout_ms, struct camera *cameras,
                  size_t *n_cameras)
{
    uint64_t wait_ms = timeout_ms < MIN_WAIT_MS ? MIN_WAIT_MS : timeout_ms;
    wait_ms = wait_ms > MAX_WAIT_MS ? MAX_WAIT_MS : wait_ms;
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_addr = route->from};
    int yes = 1;
    *n_cameras = 0;
    int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (fd < 0)
        return fail(GC_ERR_RESOURCE_EXHAUSTED, "no socket: %s", strerror(errno));
    if (bind(fd, (struct sockaddr *)&own, sizeof own) ||
        (route->is_broadcast && setsockopt(fd, SOL_SOCKET, SO_BROADCAST, &yes, sizeof yes))) {
        int error = errno;
        close(fd);
        return fail(GC_ERR_IO, "%s: no discovery: %s", route->name, strerror(error));
    }
    bool is_done = false;
    for (uint16_t id = 1; id <= PROBES && !is_done; id++) {
        uint8_t probe[GVCP_HEADER_SIZE];
        gvcp_write_header(probe, GVCP_DISCOVERY, 0, id);
        /* A route that is down has no cameras, which is no error. */
        (void)sendto(fd, probe, sizeof probe, 0, (const struct sockaddr *)&route->target,
                     sizeof route->target);
        is_done = collect(fd, route, clock_us() + 1000 * wait_ms / PROBES, cameras, n_cameras);
    }
    close(fd);
    return GC_ERR_SUCCESS;
}
