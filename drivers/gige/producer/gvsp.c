#include "gvsp.h"

#include "wire.h"

enum { LEADER_SIZE = 20, IMAGE_LEADER_SIZE = 44, TRAILER_SIZE = 16 };
enum { PAYLOAD_IMAGE = 0x0001, PAYLOAD_HAS_CHUNKS = 0x4000 };
enum { EXTENDED_ID = 0x80, FORMAT_MASK = 0x0f };

static bool parse_leader(const uint8_t *bytes, size_t size, struct gvsp_packet *packet)
{
    if (size < LEADER_SIZE)
        return false;
    uint16_t payload_type = load16(bytes + 10);
    packet->image.timestamp_ticks = load64(bytes + 12);
    packet->has_chunks = (payload_type & PAYLOAD_HAS_CHUNKS) != 0;
    packet->has_image = (payload_type & ~PAYLOAD_HAS_CHUNKS) == PAYLOAD_IMAGE;
    if (!packet->has_image)
        return true;
    if (size < IMAGE_LEADER_SIZE)
        return false;
    packet->image.pixel_format = load32(bytes + 20);
    packet->image.width = load32(bytes + 24);
    packet->image.height = load32(bytes + 28);
    packet->image.offset_x = load32(bytes + 32);
    packet->image.offset_y = load32(bytes + 36);
    packet->image.padding_x = load16(bytes + 40);
    packet->image.padding_y = load16(bytes + 42);
    return true;
}

static bool parse_trailer(const uint8_t *bytes, size_t size, struct gvsp_packet *packet)
{
    if (size < TRAILER_SIZE || packet->packet_id == 0)
        return false;
    packet->lines = load32(bytes + 12);
    return true;
}

static bool parse_payload(const uint8_t *bytes, size_t size, struct gvsp_packet *packet)
{
    packet->data = bytes + GVSP_HEADER_SIZE;
    packet->data_size = size - GVSP_HEADER_SIZE;
    return packet->data_size > 0 && packet->packet_id > 0;
}

bool gvsp_parse(const uint8_t *bytes, size_t size, struct gvsp_packet *packet)
{
    if (size < GVSP_HEADER_SIZE)
        return false;
    *packet = (struct gvsp_packet){
        .status = load16(bytes),
        .block_id = load16(bytes + 2),
        .packet_id = load32(bytes + 4) & 0xffffffu,
    };
    /* Extended ids are sent only to an application that asked for them, and block 0 is the
     * test packet's. */
    if ((bytes[4] & EXTENDED_ID) || packet->block_id == 0)
        return false;
    if (packet->status & 0x8000) {
        packet->kind = GVSP_ERROR;
        return true;
    }
    packet->kind = (enum gvsp_kind)(bytes[4] & FORMAT_MASK);
    switch (packet->kind) {
    case GVSP_LEADER:
        return parse_leader(bytes, size, packet);
    case GVSP_TRAILER:
        return parse_trailer(bytes, size, packet);
    case GVSP_PAYLOAD:
        return parse_payload(bytes, size, packet);
    default:
        return false;
    }
}

int32_t gvsp_block_distance(uint16_t earlier, uint16_t later)
{
    int32_t ahead = ((int32_t)later - (int32_t)earlier + GVSP_BLOCK_IDS) % GVSP_BLOCK_IDS;
    return ahead > GVSP_BLOCK_IDS / 2 ? ahead - GVSP_BLOCK_IDS : ahead;
}

uint64_t gvsp_image_bytes(const struct gvsp_image *image)
{
    uint64_t bits_per_pixel = image->pixel_format >> 16 & 0xff;
    uint64_t pixels = (uint64_t)image->width * image->height;
    if (pixels >> 48)
        return UINT64_MAX; /* no image has so many, and the products below would overflow */
    uint64_t whole = pixels / 8 * bits_per_pixel + (pixels % 8 * bits_per_pixel + 7) / 8;
    return whole + (uint64_t)image->height * image->padding_x + image->padding_y;
}
