#include "receiver.h"

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "answer.h"
#include "threads.h"
#include "wire.h"

/* Some frames of the largest cameras: the kernel grants what net.core.rmem_max allows. */
enum { SOCKET_BUFFER_SIZE = 32 << 20 };
enum { BATCH = 64, MAX_BATCHES = 8 };
enum { MIN_PACKET_SIZE = 64 };
/* How long a test packet may take, and the sizes to try: the jumbo frame that cameras and network
 * cards agree on, the Ethernet frame, and what every host must accept. */
enum { TEST_PACKET_US = 50000 };
static const uint32_t PACKET_SIZES[] = {8228, 1500, 576};
enum { PACKET_SIZE_LIMIT = 9216, UDP_OVERHEAD = 20 + 8 };

struct receiver {
    struct gvcp *channel;
    struct in_addr camera;
    int socket;
    size_t packet_size;
    struct assembly *assembly;
    struct stoppable_thread thread;
    pthread_mutex_t counts_lock;
    struct assembly_counts counts; /* a copy of the assembly's, which is the thread's own */
    uint8_t *bytes;                /* BATCH datagrams */
};

static GC_ERROR open_socket(struct in_addr host, int *fd, uint16_t *port)
{
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_addr = host};
    socklen_t size = sizeof own;
    int wanted = SOCKET_BUFFER_SIZE;
    *fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (*fd < 0)
        return fail(GC_ERR_RESOURCE_EXHAUSTED, "no socket: %s", strerror(errno));
    if (setsockopt(*fd, SOL_SOCKET, SO_RCVBUFFORCE, &wanted, sizeof wanted))
        (void)setsockopt(*fd, SOL_SOCKET, SO_RCVBUF, &wanted, sizeof wanted);
    if (bind(*fd, (struct sockaddr *)&own, sizeof own) ||
        getsockname(*fd, (struct sockaddr *)&own, &size)) {
        int error = errno;
        close(*fd);
        return fail(GC_ERR_IO, "no stream socket: %s", strerror(error));
    }
    *port = ntohs(own.sin_port);
    return GC_ERR_SUCCESS;
}

static GC_ERROR point_stream_at(struct gvcp *channel, uint16_t port)
{
    GC_ERROR error = gvcp_write_register(channel, GVCP_STREAM_DESTINATION,
                                         ntohl(gvcp_host(channel).s_addr));
    return error ? error : gvcp_write_register(channel, GVCP_STREAM_HOST_PORT, port);
}

static void publish_counts(struct receiver *receiver)
{
    pthread_mutex_lock(&receiver->counts_lock);
    receiver->counts = *assembly_counts(receiver->assembly);
    pthread_mutex_unlock(&receiver->counts_lock);
}

/* Take in what waits at the socket, one batch; false if nothing did. */
static bool receive_batch(struct receiver *receiver)
{
    struct mmsghdr messages[BATCH] = {0};
    struct iovec parts[BATCH];
    struct sockaddr_in senders[BATCH];
    for (size_t i = 0; i < BATCH; i++) {
        parts[i] = (struct iovec){.iov_base = receiver->bytes + i * receiver->packet_size,
                                  .iov_len = receiver->packet_size};
        messages[i].msg_hdr.msg_iov = &parts[i];
        messages[i].msg_hdr.msg_iovlen = 1;
        messages[i].msg_hdr.msg_name = &senders[i];
        messages[i].msg_hdr.msg_namelen = sizeof senders[i];
    }
    int n_messages = recvmmsg(receiver->socket, messages, BATCH, MSG_DONTWAIT, NULL);
    uint64_t now = clock_us();
    for (int i = 0; i < n_messages; i++)
        if (senders[i].sin_addr.s_addr == receiver->camera.s_addr &&
            !(messages[i].msg_hdr.msg_flags & MSG_TRUNC))
            assembly_accept(receiver->assembly, parts[i].iov_base, messages[i].msg_len, now);
    return n_messages > 0;
}

static void receive(void *context)
{
    struct receiver *receiver = context;
    uint64_t next_us = UINT64_MAX;
    for (;;) {
        struct pollfd ready[] = {{.fd = receiver->socket, .events = POLLIN},
                                 {.fd = receiver->thread.stop_event, .events = POLLIN}};
        uint64_t now = clock_us();
        struct timespec wait = timespec_from_us(next_us > now ? next_us - now : 0);
        (void)ppoll(ready, 2, next_us == UINT64_MAX ? NULL : &wait, NULL);
        if (ready[1].revents)
            return;
        for (int i = 0; i < MAX_BATCHES && receive_batch(receiver); i++)
            continue;
        next_us = assembly_tick(receiver->assembly, clock_us());
        publish_counts(receiver);
    }
}

static void free_receiver(struct receiver *receiver)
{
    if (receiver->assembly)
        assembly_free(receiver->assembly);
    pthread_mutex_destroy(&receiver->counts_lock);
    close(receiver->socket);
    free(receiver->bytes);
    free(receiver);
}

/* Make the assembly for the packet size that the camera is set to. */
static GC_ERROR prepare(struct receiver *receiver, const struct assembly_host *host)
{
    uint32_t packet_size;
    GC_ERROR error = gvcp_read_register(receiver->channel, GVCP_STREAM_PACKET_SIZE, &packet_size);
    if (error)
        return error;
    packet_size &= GVCP_PACKET_SIZE_MASK;
    if (packet_size < MIN_PACKET_SIZE)
        return fail(GC_ERR_IO, "GevSCPSPacketSize of the camera is %u; set at least %d",
                    packet_size, MIN_PACKET_SIZE);
    receiver->packet_size = packet_size;
    receiver->bytes = malloc((size_t)BATCH * packet_size);
    receiver->assembly = assembly_new(host, packet_size);
    if (!receiver->bytes || !receiver->assembly)
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory to receive packets of %u bytes", packet_size);
    return GC_ERR_SUCCESS;
}

GC_ERROR receiver_start(struct gvcp *channel, const struct sockaddr_in *camera,
                        const struct assembly_host *host, struct receiver **receiver)
{
    struct receiver *made = calloc(1, sizeof *made);
    uint16_t port;
    if (!made)
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory for a receiver");
    GC_ERROR error = open_socket(gvcp_host(channel), &made->socket, &port);
    if (error) {
        free(made);
        return error;
    }
    made->channel = channel;
    made->camera = camera->sin_addr;
    pthread_mutex_init(&made->counts_lock, NULL);
    error = prepare(made, host);
    if (!error)
        error = point_stream_at(channel, port);
    if (!error)
        error = thread_start(&made->thread, receive, made);
    if (error) {
        free_receiver(made);
        return error;
    }
    *receiver = made;
    return GC_ERR_SUCCESS;
}

struct assembly_counts receiver_stop(struct receiver *receiver)
{
    thread_stop(&receiver->thread);
    struct assembly_counts counts = *assembly_counts(receiver->assembly);
    /* A camera that is gone has no stream to close. */
    (void)gvcp_write_register(receiver->channel, GVCP_STREAM_HOST_PORT, 0);
    free_receiver(receiver);
    return counts;
}

struct assembly_counts receiver_counts(struct receiver *receiver)
{
    pthread_mutex_lock(&receiver->counts_lock);
    struct assembly_counts counts = receiver->counts;
    pthread_mutex_unlock(&receiver->counts_lock);
    return counts;
}

/* Whether a test packet of this size arrives. */
static bool passes(struct gvcp *channel, int fd, uint32_t packet_size)
{
    uint8_t bytes[PACKET_SIZE_LIMIT];
    uint32_t command = GVCP_FIRE_TEST_PACKET | GVCP_DO_NOT_FRAGMENT | packet_size;
    if (gvcp_write_register(channel, GVCP_STREAM_PACKET_SIZE, command))
        return false;
    uint64_t end = clock_us() + TEST_PACKET_US;
    for (uint64_t now = clock_us(); now < end; now = clock_us()) {
        struct pollfd readable = {.fd = fd, .events = POLLIN};
        if (poll(&readable, 1, (int)((end - now) / 1000 + 1)) > 0 &&
            recv(fd, bytes, sizeof bytes, MSG_TRUNC) == (ssize_t)(packet_size - UDP_OVERHEAD))
            return true;
    }
    return false;
}

static uint32_t largest_passing(struct gvcp *channel, int fd)
{
    for (size_t i = 0; i < sizeof PACKET_SIZES / sizeof PACKET_SIZES[0]; i++)
        for (int attempt = 0; attempt < 2; attempt++)
            if (passes(channel, fd, PACKET_SIZES[i]))
                return PACKET_SIZES[i];
    return 0;
}

GC_ERROR negotiate_packet_size(struct gvcp *channel, uint32_t fixed)
{
    uint32_t before;
    uint16_t port;
    int fd;
    if (fixed)
        return gvcp_write_register(channel, GVCP_STREAM_PACKET_SIZE, fixed);
    GC_ERROR error = gvcp_read_register(channel, GVCP_STREAM_PACKET_SIZE, &before);
    if (!error)
        error = open_socket(gvcp_host(channel), &fd, &port);
    if (error)
        return error;
    error = point_stream_at(channel, port);
    if (!error) {
        uint32_t found = largest_passing(channel, fd);
        error = gvcp_write_register(channel, GVCP_STREAM_PACKET_SIZE,
                                    found ? found : before & GVCP_PACKET_SIZE_MASK);
    }
    if (!error)
        error = gvcp_write_register(channel, GVCP_STREAM_HOST_PORT, 0);
    close(fd);
    return error;
}
