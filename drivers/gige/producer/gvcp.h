/* The control channel of a GigE Vision camera (GVCP): commands, registers, privilege, heartbeat. */
#ifndef TRONLAB_GVCP_H
#define TRONLAB_GVCP_H

#include <netinet/in.h>
#include <stdbool.h>

#include "gentl.h"

enum { GVCP_PORT = 3956, GVCP_HEADER_SIZE = 8 };

/* The most bytes one READMEM or WRITEMEM carries: what fits 576 bytes of IP packet. */
enum { GVCP_MAX_MEMORY = 536 };

enum gvcp_command {
    GVCP_DISCOVERY = 0x0002,
    GVCP_DISCOVERY_ACK = 0x0003,
    GVCP_PACKETRESEND = 0x0040,
    GVCP_READREG = 0x0080,
    GVCP_WRITEREG = 0x0082,
    GVCP_READMEM = 0x0084,
    GVCP_WRITEMEM = 0x0086,
    GVCP_PENDING_ACK = 0x0089,
};

/* Bootstrap registers, as the GigE Vision standard names and places them. */
enum gvcp_register {
    GVCP_FIRST_URL = 0x0200,
    GVCP_SECOND_URL = 0x0400,
    GVCP_HEARTBEAT_TIMEOUT_MS = 0x0938,
    GVCP_TICK_FREQUENCY_HIGH = 0x093c,
    GVCP_TICK_FREQUENCY_LOW = 0x0940,
    GVCP_CONTROL_PRIVILEGE = 0x0a00,
    GVCP_STREAM_HOST_PORT = 0x0d00,
    GVCP_STREAM_PACKET_SIZE = 0x0d04,
    GVCP_STREAM_DESTINATION = 0x0d18,
};

enum { GVCP_URL_SIZE = 512 };

/* Bits of GVCP_CONTROL_PRIVILEGE. */
enum { GVCP_EXCLUSIVE = 1, GVCP_CONTROL = 2 };

/* Bits of GVCP_STREAM_PACKET_SIZE. */
#define GVCP_FIRE_TEST_PACKET 0x80000000u
#define GVCP_DO_NOT_FRAGMENT 0x40000000u
#define GVCP_PACKET_SIZE_MASK 0x0000ffffu

struct gvcp_ack {
    uint16_t status;
    uint16_t command;
    uint16_t request_id;
    const uint8_t *payload;
    size_t payload_size;
};

/* Read one acknowledge; false if it is none. Touches nothing but its arguments. */
bool gvcp_parse_ack(const uint8_t *bytes, size_t size, struct gvcp_ack *ack);

/* Write the header of a command of `payload_size` bytes that asks for an acknowledge. */
void gvcp_write_header(uint8_t *bytes, enum gvcp_command command, size_t payload_size,
                       uint16_t request_id);

struct gvcp;

/* Open a socket to a camera, from the host's address `from` (INADDR_ANY: as routed). */
GC_ERROR gvcp_open(const struct sockaddr_in *camera, struct in_addr from, struct gvcp **channel);
void gvcp_close(struct gvcp *channel);

/* The host's own address as the camera sees it. */
struct in_addr gvcp_host(const struct gvcp *channel);

/* All of these retry, wait as PENDING_ACK asks, and fail with GC_ERR_TIMEOUT on silence, with
 * GC_ERR_IO at once after the loss of the camera, else with what the status code means. */
GC_ERROR gvcp_read_register(struct gvcp *channel, uint32_t address, uint32_t *value);
GC_ERROR gvcp_write_register(struct gvcp *channel, uint32_t address, uint32_t value);
GC_ERROR gvcp_read(struct gvcp *channel, uint64_t address, uint8_t *bytes, size_t size);
GC_ERROR gvcp_write(struct gvcp *channel, uint64_t address, const uint8_t *bytes, size_t size);

/* Ask for packets first..last of a block again; not acknowledged. */
void gvcp_request_resend(struct gvcp *channel, uint16_t block_id, uint32_t first, uint32_t last);

/* Keep the privilege: read it three times in a heartbeat. `on_lost` is called once, from the
 * heartbeat's own thread, when the camera was silent for a heartbeat or the privilege is gone. */
GC_ERROR gvcp_start_heartbeat(struct gvcp *channel, void (*on_lost)(void *context),
                              void *context);
void gvcp_stop_heartbeat(struct gvcp *channel);

bool gvcp_is_lost(const struct gvcp *channel);

#endif
