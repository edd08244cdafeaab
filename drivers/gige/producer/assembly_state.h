/* What an assembly remembers; of no concern to its users. */
#ifndef TRONLAB_ASSEMBLY_STATE_H
#define TRONLAB_ASSEMBLY_STATE_H

#include "assembly.h"

enum packet_state { MISSING, RECEIVED, REFUSED };

/* A frame under way. Packets of the payload have ids 1..n_packets. */
struct assembling {
    struct frame *frame;
    uint8_t *states;    /* of packet i at [i - 1] */
    size_t room;        /* of states */
    uint32_t capacity;  /* packets that fit the buffer */
    uint32_t n_packets; /* the capacity, until leader or trailer tell */
    uint32_t n_received;
    uint32_t highest; /* id received so far */
    bool has_leader, has_trailer, is_leader_refused, is_trailer_refused, is_given_up;
    uint32_t rounds, n_requested;
    uint64_t last_packet_us;
    uint64_t next_request_us; /* 0 while nothing is known to be missing */
};

struct assembly {
    struct assembly_host host;
    struct assembly_counts counts;
    size_t chunk; /* payload bytes a packet */
    struct assembling slots[ASSEMBLY_DEPTH];
    struct assembling *queue[ASSEMBLY_DEPTH]; /* oldest first */
    size_t n_queued;
    bool has_newest;
    uint16_t newest;
    bool is_newest_stamped;
    uint64_t newest_ticks;
    uint64_t requests_paid_us; /* the clock of the request rate */
};

/* Deliver the frames that wait for nothing more. They leave in the order of their blocks, so that a
 * frame waits for the older ones. */
void assembly_deliver_finished(struct assembly *assembly);

#endif
