/* Frames put together from GVSP packets: no sockets, no threads, the time is given. */
#ifndef TRONLAB_ASSEMBLY_H
#define TRONLAB_ASSEMBLY_H

#include "gvsp.h"

/* Frames that may be under way at once, waiting for packets sent again. */
enum { ASSEMBLY_DEPTH = 16 };

/* One buffer of the consumer, and what is known of the frame in it. */
struct frame {
    uint8_t *base;
    size_t size;

    size_t filled;
    uint16_t block_id;
    bool has_image;
    bool has_chunks;
    struct gvsp_image image;
    uint32_t lines;
    bool is_incomplete;
    bool is_too_large; /* the payload is larger than the buffer */
};

/* What the assembly asks of its surroundings. */
struct assembly_host {
    void *context;
    struct frame *(*take)(void *context); /* an empty buffer, NULL if there is none */
    void (*deliver)(void *context, struct frame *frame);
    void (*give_back)(void *context, struct frame *frame);
    void (*request)(void *context, uint16_t block_id, uint32_t first, uint32_t last);
};

struct assembly_counts {
    uint64_t started;           /* frames begun */
    uint64_t incomplete;        /* delivered with packets missing */
    uint64_t underruns;         /* frames dropped because no buffer was queued */
    uint64_t skipped;           /* block ids of which no packet came */
    uint64_t packets_requested; /* asked for again */
    uint64_t packets_refused;   /* no longer held by the camera, or in error there */
    uint64_t packets_stale;     /* duplicates, and late for a frame already done with */
    uint64_t packets_malformed;
};

struct assembly;

/* `packet_size` as in GevSCPSPacketSize. NULL if memory is short. */
struct assembly *assembly_new(const struct assembly_host *host, size_t packet_size);

/* Give back the buffers under way. */
void assembly_free(struct assembly *assembly);

/* Take in one datagram, of any content. */
void assembly_accept(struct assembly *assembly, const uint8_t *bytes, size_t size,
                     uint64_t now_us);

/* Request what is missing and give up what will not come; call it between batches of datagrams.
 * Returns when it wants to be called next, UINT64_MAX if no frame is under way. */
uint64_t assembly_tick(struct assembly *assembly, uint64_t now_us);

const struct assembly_counts *assembly_counts(const struct assembly *assembly);

#endif
