/* The receiving end of a stream channel: one socket and one thread a stream. */
#ifndef TRONLAB_RECEIVER_H
#define TRONLAB_RECEIVER_H

#include "assembly.h"
#include "gvcp.h"

struct receiver;

/* Point the camera's stream channel at a new socket of this host and begin to receive. `host` is
 * called from the receiver's thread. */
GC_ERROR receiver_start(struct gvcp *channel, const struct sockaddr_in *camera,
                        const struct assembly_host *host, struct receiver **receiver);

/* Close the stream channel; buffers under way are given back. Returns the final counts. */
struct assembly_counts receiver_stop(struct receiver *receiver);

/* As counted some milliseconds ago at most. */
struct assembly_counts receiver_counts(struct receiver *receiver);

/* Find the largest packet that comes through unfragmented, by the camera's test packets, and set
 * it. A camera that sends none keeps what it has. `fixed` > 0 sets that size instead. */
GC_ERROR negotiate_packet_size(struct gvcp *channel, uint32_t fixed);

#endif
