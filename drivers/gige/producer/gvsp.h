/* The packets of a GigE Vision stream (GVSP), read from bytes. */
#ifndef TRONLAB_GVSP_H
#define TRONLAB_GVSP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* IP, UDP and GVSP headers, all of which the packet size register (GevSCPSPacketSize) includes. */
enum { GVSP_HEADER_SIZE = 8, GVSP_OVERHEAD = 20 + 8 + GVSP_HEADER_SIZE };

/* Block ids are 16 bits wide and count 1..65535: 0 is skipped at the wrap. */
enum { GVSP_BLOCK_IDS = 65535 };

enum gvsp_kind { GVSP_LEADER = 1, GVSP_TRAILER = 2, GVSP_PAYLOAD = 3, GVSP_ERROR };

/* Status codes of GigE Vision that a stream packet can carry instead of data. */
enum gvsp_status {
    GVSP_STATUS_OK = 0x0000,
    GVSP_STATUS_RESENT = 0x0100,
    GVSP_STATUS_UNAVAILABLE = 0x800c,
    GVSP_STATUS_NOT_YET_AVAILABLE = 0x8010,
    GVSP_STATUS_PREVIOUS_REMOVED = 0x8011,
    GVSP_STATUS_TEMPORARILY_UNAVAILABLE = 0x8014,
};

/* What the leader tells of an image; sizes in pixels, paddings in bytes. */
struct gvsp_image {
    uint64_t timestamp_ticks;
    uint32_t pixel_format;
    uint32_t width, height;
    uint32_t offset_x, offset_y;
    uint16_t padding_x, padding_y;
};

struct gvsp_packet {
    enum gvsp_kind kind;
    uint16_t status;
    uint16_t block_id;
    uint32_t packet_id;
    bool has_image;          /* leader: the payload is an image, described by `image` */
    bool has_chunks;         /* leader: chunk data follow the image */
    struct gvsp_image image; /* timestamp: of every leader; the rest only if has_image */
    uint32_t lines;          /* trailer: the lines of the image that were sent */
    const uint8_t *data;     /* payload: into the packet's bytes */
    size_t data_size;
};

/* Read one datagram. False if it is no packet of a 16-bit block id stream; `packet` is then unset.
 * Touches nothing but its arguments. */
bool gvsp_parse(const uint8_t *bytes, size_t size, struct gvsp_packet *packet);

/* How far `later` is ahead of `earlier` on the ring of block ids, -32767..32767. */
int32_t gvsp_block_distance(uint16_t earlier, uint16_t later);

/* The bytes of an image on the wire, paddings included; bits are packed over line ends. */
uint64_t gvsp_image_bytes(const struct gvsp_image *image);

#endif
