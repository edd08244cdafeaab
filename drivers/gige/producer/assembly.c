#include "assembly.h"

#include <stdlib.h>
#include <string.h>

#include "assembly_state.h"

/* A leader this far behind the newest block is no late packet: the camera began anew. */
enum { RESTART_DISTANCE = 64 };

struct assembly *assembly_new(const struct assembly_host *host, size_t packet_size)
{
    struct assembly *assembly = calloc(1, sizeof *assembly);
    if (!assembly)
        return NULL;
    assembly->host = *host;
    assembly->chunk = packet_size - GVSP_OVERHEAD;
    return assembly;
}

void assembly_free(struct assembly *assembly)
{
    for (size_t i = 0; i < assembly->n_queued; i++)
        assembly->host.give_back(assembly->host.context, assembly->queue[i]->frame);
    for (size_t i = 0; i < ASSEMBLY_DEPTH; i++)
        free(assembly->slots[i].states);
    free(assembly);
}

const struct assembly_counts *assembly_counts(const struct assembly *assembly)
{
    return &assembly->counts;
}

static bool has_all_packets(const struct assembling *slot)
{
    return slot->has_leader && slot->n_received == slot->n_packets;
}

static bool is_finished(const struct assembling *slot)
{
    return slot->is_given_up || (has_all_packets(slot) && slot->has_trailer);
}

static void deliver_oldest(struct assembly *assembly)
{
    struct assembling *slot = assembly->queue[0];
    struct frame *frame = slot->frame;
    /* The trailer repeats what is known of an image, so that its loss harms nothing. */
    bool is_whole = has_all_packets(slot) && !frame->is_too_large &&
                    (slot->has_trailer || (frame->has_image && !frame->has_chunks)) &&
                    (!frame->has_image || frame->filled >= gvsp_image_bytes(&frame->image));
    frame->is_incomplete = !is_whole;
    assembly->counts.incomplete += frame->is_incomplete;
    slot->frame = NULL;
    assembly->n_queued--;
    memmove(assembly->queue, assembly->queue + 1, assembly->n_queued * sizeof assembly->queue[0]);
    assembly->host.deliver(assembly->host.context, frame);
}

void assembly_deliver_finished(struct assembly *assembly)
{
    while (assembly->n_queued && is_finished(assembly->queue[0]))
        deliver_oldest(assembly);
}

static struct assembling *find(struct assembly *assembly, uint16_t block_id)
{
    for (size_t i = 0; i < assembly->n_queued; i++)
        if (assembly->queue[i]->frame->block_id == block_id)
            return assembly->queue[i];
    return NULL;
}

static struct assembling *free_slot(struct assembly *assembly)
{
    if (assembly->n_queued == ASSEMBLY_DEPTH)
        deliver_oldest(assembly);
    struct assembling *slot = assembly->slots;
    while (slot->frame)
        slot++;
    return slot;
}

static bool reset_slot(struct assembling *slot, struct frame *frame, size_t chunk)
{
    size_t n_packets = (frame->size + chunk - 1) / chunk;
    uint8_t *states = slot->states;
    size_t room = slot->room;
    if (room < n_packets) {
        states = realloc(states, n_packets);
        if (!states)
            return false;
        room = n_packets;
    }
    memset(states, MISSING, n_packets);
    *slot = (struct assembling){
        .frame = frame,
        .states = states,
        .room = room,
        .capacity = (uint32_t)n_packets,
        .n_packets = (uint32_t)n_packets,
    };
    return true;
}

/* Begin a block newer than all before. NULL if there is no buffer for it. */
static struct assembling *begin(struct assembly *assembly, uint16_t block_id)
{
    if (assembly->has_newest) {
        int32_t distance = gvsp_block_distance(assembly->newest, block_id);
        if (distance > 1)
            assembly->counts.skipped += (uint32_t)distance - 1;
    }
    assembly->has_newest = true;
    assembly->newest = block_id;
    assembly->is_newest_stamped = false;
    assembly->counts.started++;

    struct assembling *slot = free_slot(assembly);
    struct frame *frame = assembly->host.take(assembly->host.context);
    if (!frame) {
        assembly->counts.underruns++;
        return NULL;
    }
    if (!reset_slot(slot, frame, assembly->chunk)) {
        assembly->host.give_back(assembly->host.context, frame);
        assembly->counts.underruns++;
        return NULL;
    }
    *frame = (struct frame){.base = frame->base, .size = frame->size, .block_id = block_id};
    assembly->queue[assembly->n_queued++] = slot;
    return slot;
}

/* A consumer that restarts the camera makes it count from 1 again: that is a later leader of a
 * block that is not newer. */
static bool is_restart(const struct assembly *assembly, const struct gvsp_packet *packet)
{
    if (packet->kind != GVSP_LEADER || packet->status == GVSP_STATUS_RESENT)
        return false;
    int32_t behind = gvsp_block_distance(packet->block_id, assembly->newest);
    if (behind >= RESTART_DISTANCE)
        return true;
    return behind >= 0 && assembly->is_newest_stamped &&
           packet->image.timestamp_ticks > assembly->newest_ticks;
}

static void begin_anew(struct assembly *assembly)
{
    while (assembly->n_queued)
        deliver_oldest(assembly);
    assembly->has_newest = false;
}

/* A leader begins any newer block; another packet one so near that its leader may have been lost,
 * lest a stray packet carry the stream away. An error packet only answers a request. */
static bool may_begin(const struct assembly *assembly, const struct gvsp_packet *packet)
{
    if (packet->kind == GVSP_ERROR)
        return false;
    if (!assembly->has_newest)
        return true;
    int32_t distance = gvsp_block_distance(assembly->newest, packet->block_id);
    return distance > 0 && (packet->kind == GVSP_LEADER || distance <= ASSEMBLY_DEPTH);
}

/* The frame a packet belongs to, begun if need be. NULL if the packet is of no use. */
static struct assembling *slot_of(struct assembly *assembly, const struct gvsp_packet *packet)
{
    if (assembly->has_newest && is_restart(assembly, packet))
        begin_anew(assembly);
    struct assembling *slot = may_begin(assembly, packet) ? begin(assembly, packet->block_id)
                                                          : find(assembly, packet->block_id);
    if (packet->kind == GVSP_LEADER && packet->block_id == assembly->newest) {
        assembly->is_newest_stamped = true;
        assembly->newest_ticks = packet->image.timestamp_ticks;
    }
    if (!slot)
        assembly->counts.packets_stale++;
    return slot;
}

static void set_packet_count(struct assembling *slot, uint64_t n_packets)
{
    slot->frame->is_too_large |= n_packets > slot->capacity;
    slot->n_packets = n_packets < slot->capacity ? (uint32_t)n_packets : slot->capacity;
    slot->n_received = 0;
    for (uint32_t i = 0; i < slot->n_packets; i++)
        slot->n_received += slot->states[i] == RECEIVED;
}

static void accept_leader(struct assembly *assembly, struct assembling *slot,
                          const struct gvsp_packet *packet)
{
    struct frame *frame = slot->frame;
    slot->has_leader = true;
    frame->has_image = packet->has_image;
    frame->has_chunks = packet->has_chunks;
    frame->image = packet->image;
    if (!slot->has_trailer)
        frame->lines = packet->image.height;
    if (!packet->has_image)
        return;
    uint64_t bytes = gvsp_image_bytes(&packet->image);
    frame->is_too_large |= bytes > frame->size;
    /* Chunk data follow the image: then only the trailer knows the number of packets. */
    if (!packet->has_chunks && !slot->has_trailer)
        set_packet_count(slot, bytes / assembly->chunk + (bytes % assembly->chunk != 0));
}

static void accept_trailer(struct assembling *slot, const struct gvsp_packet *packet)
{
    slot->has_trailer = true;
    slot->frame->lines = packet->lines;
    set_packet_count(slot, packet->packet_id - 1);
}

static bool is_plain_image(const struct frame *frame)
{
    return frame->has_image && !frame->has_chunks;
}

/* The bytes a payload packet has at least, as far as the leader lets us know. */
static uint64_t least_size(const struct assembly *assembly, const struct assembling *slot,
                           uint32_t packet_id)
{
    uint64_t offset = (uint64_t)(packet_id - 1) * assembly->chunk;
    uint64_t bytes = gvsp_image_bytes(&slot->frame->image);
    if (!slot->has_leader || !is_plain_image(slot->frame) || bytes <= offset)
        return 1;
    return bytes - offset < assembly->chunk ? bytes - offset : assembly->chunk;
}

static bool is_payload_sound(const struct assembly *assembly, const struct assembling *slot,
                             const struct gvsp_packet *packet)
{
    return packet->packet_id <= (slot->has_trailer ? slot->n_packets : slot->capacity) &&
           packet->data_size <= assembly->chunk &&
           packet->data_size >= least_size(assembly, slot, packet->packet_id);
}

static void store(struct assembly *assembly, struct frame *frame, const struct gvsp_packet *packet)
{
    size_t offset = (size_t)(packet->packet_id - 1) * assembly->chunk;
    size_t room = frame->size - offset;
    size_t size = packet->data_size < room ? packet->data_size : room;
    memcpy(frame->base + offset, packet->data, size);
    frame->filled += size;
    /* A camera may pad an image's last packet: what the leader told of decides there. */
    frame->is_too_large |= packet->data_size > room && !is_plain_image(frame);
}

static void accept_payload(struct assembly *assembly, struct assembling *slot,
                           const struct gvsp_packet *packet)
{
    if (!is_payload_sound(assembly, slot, packet)) {
        /* Of an image the leader told the size: a packet beyond it is a stray one. */
        slot->frame->is_too_large |=
            packet->packet_id > slot->capacity && !is_plain_image(slot->frame);
        assembly->counts.packets_malformed++;
        return;
    }
    if (packet->packet_id > slot->n_packets)
        set_packet_count(slot, packet->packet_id); /* more than the image the leader told of */
    uint8_t *state = &slot->states[packet->packet_id - 1];
    if (*state == RECEIVED) {
        assembly->counts.packets_stale++;
        return;
    }
    store(assembly, slot->frame, packet);
    *state = RECEIVED;
    slot->n_received++;
    slot->rounds = 0;
    if (packet->packet_id > slot->highest)
        slot->highest = packet->packet_id;
}

static void refuse(struct assembling *slot, uint32_t packet_id)
{
    if (packet_id == 0)
        slot->is_leader_refused = !slot->has_leader;
    else if (packet_id > slot->n_packets)
        slot->is_trailer_refused = !slot->has_trailer;
    else if (slot->states[packet_id - 1] == MISSING)
        slot->states[packet_id - 1] = REFUSED;
}

static void accept_error(struct assembly *assembly, struct assembling *slot,
                         const struct gvsp_packet *packet)
{
    if (packet->status == GVSP_STATUS_NOT_YET_AVAILABLE ||
        packet->status == GVSP_STATUS_TEMPORARILY_UNAVAILABLE)
        return; /* the next round asks again */
    assembly->counts.packets_refused++;
    uint32_t first = packet->status == GVSP_STATUS_PREVIOUS_REMOVED ? 0 : packet->packet_id;
    uint32_t last = packet->packet_id <= slot->n_packets ? packet->packet_id
                                                         : slot->n_packets + 1;
    for (uint32_t id = first < last ? first : last; id <= last; id++)
        refuse(slot, id);
}

void assembly_accept(struct assembly *assembly, const uint8_t *bytes, size_t size,
                     uint64_t now_us)
{
    struct gvsp_packet packet;
    if (!gvsp_parse(bytes, size, &packet)) {
        assembly->counts.packets_malformed++;
        return;
    }
    struct assembling *slot = slot_of(assembly, &packet);
    if (!slot)
        return;
    if (packet.kind != GVSP_ERROR)
        slot->last_packet_us = now_us;
    switch (packet.kind) {
    case GVSP_LEADER:
        accept_leader(assembly, slot, &packet);
        break;
    case GVSP_TRAILER:
        accept_trailer(slot, &packet);
        break;
    case GVSP_PAYLOAD:
        accept_payload(assembly, slot, &packet);
        break;
    case GVSP_ERROR:
        accept_error(assembly, slot, &packet);
        break;
    }
    assembly_deliver_finished(assembly);
}
