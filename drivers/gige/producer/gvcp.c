#include "gvcp.h"

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "answer.h"
#include "threads.h"
#include "wire.h"

enum { KEY = 0x42, ACKNOWLEDGE_REQUIRED = 0x01 };
enum { ATTEMPTS = 4, ANSWER_US = 250000 };
/* A camera may ask for patience with PENDING_ACK, but not for ever. */
enum { MAX_PENDING_US = 60 * 1000000 };
/* Cameras may allow a heartbeat of minutes, but their loss should be noticed sooner. */
enum { DEFAULT_HEARTBEAT_MS = 3000, MIN_HEARTBEAT_MS = 500 };
enum { MAX_PAUSE_MS = 1000, MAX_PATIENCE_MS = 5000 };
enum { DATAGRAM_SIZE = 1500 };

struct gvcp {
    int socket;
    struct in_addr host;
    pthread_mutex_t lock; /* one command at a time */
    _Atomic uint16_t request_id;
    _Atomic bool is_lost;
    struct stoppable_thread heartbeat;
    uint32_t heartbeat_ms;
    void (*on_lost)(void *context);
    void *context;
};

bool gvcp_parse_ack(const uint8_t *bytes, size_t size, struct gvcp_ack *ack)
{
    if (size < GVCP_HEADER_SIZE || load16(bytes + 4) > size - GVCP_HEADER_SIZE)
        return false;
    *ack = (struct gvcp_ack){
        .status = load16(bytes),
        .command = load16(bytes + 2),
        .request_id = load16(bytes + 6),
        .payload = bytes + GVCP_HEADER_SIZE,
        .payload_size = load16(bytes + 4),
    };
    return true;
}

void gvcp_write_header(uint8_t *bytes, enum gvcp_command command, size_t payload_size,
                       uint16_t request_id)
{
    bytes[0] = KEY;
    bytes[1] = ACKNOWLEDGE_REQUIRED;
    store16(bytes + 2, (uint16_t)command);
    store16(bytes + 4, (uint16_t)payload_size);
    store16(bytes + 6, request_id);
}

GC_ERROR gvcp_open(const struct sockaddr_in *camera, struct in_addr from, struct gvcp **channel)
{
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_addr = from};
    socklen_t size = sizeof own;
    int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (fd < 0)
        return fail(GC_ERR_RESOURCE_EXHAUSTED, "no socket: %s", strerror(errno));
    struct gvcp *made = calloc(1, sizeof *made);
    if (!made || bind(fd, (struct sockaddr *)&own, sizeof own) ||
        connect(fd, (const struct sockaddr *)camera, sizeof *camera) ||
        getsockname(fd, (struct sockaddr *)&own, &size)) {
        int error = errno;
        close(fd);
        free(made);
        return fail(GC_ERR_IO, "the camera cannot be reached: %s", strerror(error));
    }
    made->socket = fd;
    made->host = own.sin_addr;
    pthread_mutex_init(&made->lock, NULL);
    *channel = made;
    return GC_ERR_SUCCESS;
}

void gvcp_close(struct gvcp *channel)
{
    gvcp_stop_heartbeat(channel);
    close(channel->socket);
    pthread_mutex_destroy(&channel->lock);
    free(channel);
}

struct in_addr gvcp_host(const struct gvcp *channel)
{
    return channel->host;
}

bool gvcp_is_lost(const struct gvcp *channel)
{
    return atomic_load(&channel->is_lost);
}

static uint16_t next_request_id(struct gvcp *channel)
{
    uint16_t id = (uint16_t)(atomic_fetch_add(&channel->request_id, 1) + 1);
    return id ? id : next_request_id(channel);
}

static GC_ERROR error_from_status(uint16_t status)
{
    switch (status) {
    case 0x8001:
        return GC_ERR_NOT_IMPLEMENTED;
    case 0x8002:
        return GC_ERR_INVALID_PARAMETER;
    case 0x8003: /* invalid address */
    case 0x8005: /* bad alignment */
        return GC_ERR_INVALID_ADDRESS;
    case 0x8004: /* write protected */
    case 0x8006:
        return GC_ERR_ACCESS_DENIED;
    case 0x8007:
        return GC_ERR_BUSY;
    default:
        return GC_ERR_IO;
    }
}

/* Wait for the acknowledge of `request_id` in `bytes`; false after silence. */
static bool await_ack(struct gvcp *channel, uint16_t request_id, uint8_t *bytes,
                      struct gvcp_ack *ack)
{
    uint64_t begun = clock_us();
    uint64_t end = begun + ANSWER_US;
    for (uint64_t now = begun; now < end; now = clock_us()) {
        struct pollfd readable = {.fd = channel->socket, .events = POLLIN};
        if (poll(&readable, 1, (int)((end - now) / 1000 + 1)) <= 0)
            continue;
        ssize_t size = recv(channel->socket, bytes, DATAGRAM_SIZE, 0);
        if (size < 0) { /* nobody listens there, for the moment */
            usleep(10000);
            continue;
        }
        if (!gvcp_parse_ack(bytes, (size_t)size, ack) || ack->request_id != request_id)
            continue;
        if (ack->command != GVCP_PENDING_ACK)
            return true;
        if (ack->payload_size >= 4)
            end = clock_us() + 1000u * (uint64_t)load16(ack->payload + 2) + ANSWER_US;
        if (end > begun + MAX_PENDING_US)
            end = begun + MAX_PENDING_US;
    }
    return false;
}

static const char *name_of(enum gvcp_command command)
{
    switch (command) {
    case GVCP_READREG:
        return "READREG";
    case GVCP_WRITEREG:
        return "WRITEREG";
    case GVCP_READMEM:
        return "READMEM";
    default:
        return "WRITEMEM";
    }
}

/* Send a command whose payload begins with an address, and copy `result_size` bytes from `skip`
 * bytes into the acknowledge's payload. */
static GC_ERROR execute(struct gvcp *channel, enum gvcp_command command, const uint8_t *payload,
                        size_t payload_size, size_t skip, uint8_t *result, size_t result_size)
{
    uint8_t request[GVCP_HEADER_SIZE + 4 + GVCP_MAX_MEMORY];
    uint8_t bytes[DATAGRAM_SIZE];
    struct gvcp_ack ack;
    uint32_t address = load32(payload);

    if (gvcp_is_lost(channel))
        return fail(GC_ERR_IO, "the camera was lost; close the device and open it again");
    pthread_mutex_lock(&channel->lock);
    uint16_t id = next_request_id(channel);
    gvcp_write_header(request, command, payload_size, id);
    memcpy(request + GVCP_HEADER_SIZE, payload, payload_size);
    bool is_answered = false;
    for (int i = 0; i < ATTEMPTS && !is_answered && !gvcp_is_lost(channel); i++) {
        /* A refusal of the earlier datagram is reported by this call: the answer decides. */
        (void)send(channel->socket, request, GVCP_HEADER_SIZE + payload_size, 0);
        is_answered = await_ack(channel, id, bytes, &ack);
    }
    pthread_mutex_unlock(&channel->lock);

    if (!is_answered)
        return fail(GC_ERR_TIMEOUT, "%s 0x%08x: the camera does not answer", name_of(command),
                    address);
    if (ack.status != 0)
        return fail(error_from_status(ack.status), "%s 0x%08x: the camera answers status 0x%04x",
                    name_of(command), address, ack.status);
    if (ack.command != command + 1 || ack.payload_size < skip + result_size)
        return fail(GC_ERR_IO, "%s 0x%08x: the acknowledge 0x%04x of %zu bytes does not fit",
                    name_of(command), address, ack.command, ack.payload_size);
    if (result_size)
        memcpy(result, ack.payload + skip, result_size);
    return GC_ERR_SUCCESS;
}

GC_ERROR gvcp_read_register(struct gvcp *channel, uint32_t address, uint32_t *value)
{
    uint8_t payload[4], result[4];
    store32(payload, address);
    GC_ERROR error = execute(channel, GVCP_READREG, payload, sizeof payload, 0, result, 4);
    if (!error)
        *value = load32(result);
    return error;
}

GC_ERROR gvcp_write_register(struct gvcp *channel, uint32_t address, uint32_t value)
{
    uint8_t payload[8];
    store32(payload, address);
    store32(payload + 4, value);
    return execute(channel, GVCP_WRITEREG, payload, sizeof payload, 0, NULL, 0);
}

/* Read up to GVCP_MAX_MEMORY bytes; cameras answer for whole words only. */
static GC_ERROR read_block(struct gvcp *channel, uint32_t address, uint8_t *bytes, size_t size)
{
    size_t skip = address % 4;
    size_t words_size = (skip + size + 3) / 4 * 4;
    uint8_t payload[8] = {0};
    store32(payload, address - (uint32_t)skip);
    store16(payload + 6, (uint16_t)words_size);
    if (words_size == 4) {
        uint8_t word[4];
        GC_ERROR error = execute(channel, GVCP_READREG, payload, 4, 0, word, 4);
        if (!error)
            memcpy(bytes, word + skip, size);
        return error;
    }
    return execute(channel, GVCP_READMEM, payload, sizeof payload, 4 + skip, bytes, size);
}

static GC_ERROR check_range(uint64_t address, size_t size)
{
    if (address > UINT32_MAX || size > UINT32_MAX - address)
        return fail(GC_ERR_INVALID_ADDRESS, "0x%llx: GigE Vision addresses have 32 bits",
                    (unsigned long long)address);
    return GC_ERR_SUCCESS;
}

GC_ERROR gvcp_read(struct gvcp *channel, uint64_t address, uint8_t *bytes, size_t size)
{
    GC_ERROR error = check_range(address, size);
    while (!error && size) {
        size_t room = GVCP_MAX_MEMORY - address % 4;
        size_t n_bytes = size < room ? size : room;
        error = read_block(channel, (uint32_t)address, bytes, n_bytes);
        address += n_bytes;
        bytes += n_bytes;
        size -= n_bytes;
    }
    return error;
}

GC_ERROR gvcp_write(struct gvcp *channel, uint64_t address, const uint8_t *bytes, size_t size)
{
    GC_ERROR error = check_range(address, size);
    if (!error && (address % 4 || size % 4))
        return fail(GC_ERR_INVALID_ADDRESS,
                    "0x%08llx: GigE Vision writes whole words of 4 bytes, not %zu bytes",
                    (unsigned long long)address, size);
    while (!error && size) {
        uint8_t payload[4 + GVCP_MAX_MEMORY];
        size_t n_bytes = size < GVCP_MAX_MEMORY ? size : GVCP_MAX_MEMORY;
        enum gvcp_command command = n_bytes == 4 ? GVCP_WRITEREG : GVCP_WRITEMEM;
        store32(payload, (uint32_t)address);
        memcpy(payload + 4, bytes, n_bytes);
        error = execute(channel, command, payload, 4 + n_bytes, 0, NULL, 0);
        address += n_bytes;
        bytes += n_bytes;
        size -= n_bytes;
    }
    return error;
}

void gvcp_request_resend(struct gvcp *channel, uint16_t block_id, uint32_t first, uint32_t last)
{
    uint8_t request[GVCP_HEADER_SIZE + 12] = {0};
    gvcp_write_header(request, GVCP_PACKETRESEND, 12, next_request_id(channel));
    request[1] = 0; /* the packets themselves are the answer */
    store16(request + 10, block_id);
    store32(request + 12, first);
    store32(request + 16, last);
    (void)send(channel->socket, request, sizeof request, 0);
}

/* Whether the camera still answers and we still control it. A busy camera may say so, or be silent
 * for as long as it would itself wait for a heartbeat. */
static bool is_kept(struct gvcp *channel, uint64_t *answered_us)
{
    uint32_t privilege;
    uint32_t patience_ms =
        channel->heartbeat_ms < MAX_PATIENCE_MS ? channel->heartbeat_ms : MAX_PATIENCE_MS;
    GC_ERROR error = gvcp_read_register(channel, GVCP_CONTROL_PRIVILEGE, &privilege);
    if (error == GC_ERR_TIMEOUT)
        return clock_us() < *answered_us + 1000u * (uint64_t)patience_ms;
    *answered_us = clock_us();
    return error == GC_ERR_BUSY || (!error && (privilege & (GVCP_EXCLUSIVE | GVCP_CONTROL)));
}

static void beat(void *context)
{
    struct gvcp *channel = context;
    uint32_t pause_ms = channel->heartbeat_ms / 3;
    uint64_t pause_us = 1000u * (pause_ms < MAX_PAUSE_MS ? pause_ms : MAX_PAUSE_MS);
    uint64_t answered_us = clock_us();
    while (!thread_is_stopped(&channel->heartbeat, pause_us)) {
        if (is_kept(channel, &answered_us))
            continue;
        atomic_store(&channel->is_lost, true);
        channel->on_lost(channel->context);
        return;
    }
}

GC_ERROR gvcp_start_heartbeat(struct gvcp *channel, void (*on_lost)(void *context),
                              void *context)
{
    channel->on_lost = on_lost;
    channel->context = context;
    if (gvcp_read_register(channel, GVCP_HEARTBEAT_TIMEOUT_MS, &channel->heartbeat_ms))
        channel->heartbeat_ms = DEFAULT_HEARTBEAT_MS;
    if (channel->heartbeat_ms < MIN_HEARTBEAT_MS)
        channel->heartbeat_ms = MIN_HEARTBEAT_MS;
    return thread_start(&channel->heartbeat, beat, channel);
}

void gvcp_stop_heartbeat(struct gvcp *channel)
{
    thread_stop(&channel->heartbeat);
}
