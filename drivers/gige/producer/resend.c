/* What is missing of the frames under way: when to ask for it again, and when to give it up. */
#include <string.h>

#include "assembly_state.h"

/* Packets overtake each other by less than this, so that a hole older than it is a loss. */
enum { REORDER_US = 1000 };
/* A frame without its trailer is taken as cut off after this silence. */
enum { SILENCE_US = 20000 };
/* How long the camera has to send again what was requested, and how often in a row it may fail. */
enum { RESEND_US = 20000, MAX_ROUNDS = 6 };
/* Requests must not swamp a camera or a link that is already losing packets: a frame may ask for
 * half of its packets again (or a few, if it is small), the stream for a range each 0.5 ms, which
 * it may save up. */
enum { BUDGET_SHARE = 2, MIN_BUDGET = 64, RANGE_COST_US = 500, MAX_SAVED_US = 64 * RANGE_COST_US };

/* The first packet from `id` to `last` that is missing and may still come; last + 1 if none. */
static uint32_t next_missing(const struct assembling *slot, uint32_t id, uint32_t last)
{
    if (id > last)
        return last + 1;
    const uint8_t *found = memchr(slot->states + id - 1, MISSING, last - id + 1);
    return found ? (uint32_t)(found - slot->states) + 1 : last + 1;
}

static bool is_leader_missing(const struct assembling *slot)
{
    return !slot->has_leader && !slot->is_leader_refused;
}

static bool is_trailer_missing(const struct assembling *slot)
{
    return !slot->has_trailer && !slot->is_trailer_refused;
}

/* Ask for one range, as far as the frame's budget and the stream's rate allow. */
static bool request(struct assembly *assembly, struct assembling *slot, uint32_t first,
                    uint32_t last, uint64_t now_us)
{
    uint32_t share = slot->n_packets / BUDGET_SHARE;
    uint32_t budget = share > MIN_BUDGET ? share : MIN_BUDGET;
    uint32_t n_packets = last - first + 1;
    if (slot->n_requested + n_packets > budget || assembly->requests_paid_us > now_us)
        return false;
    if (assembly->requests_paid_us + MAX_SAVED_US < now_us)
        assembly->requests_paid_us = now_us - MAX_SAVED_US;
    assembly->requests_paid_us += RANGE_COST_US;
    slot->n_requested += n_packets;
    assembly->counts.packets_requested += n_packets;
    assembly->host.request(assembly->host.context, slot->frame->block_id, first, last);
    return true;
}

static void request_missing(struct assembly *assembly, struct assembling *slot, bool is_cut,
                            uint64_t now_us)
{
    uint32_t end = is_cut ? slot->n_packets : slot->highest;
    bool may_ask = true;
    if (is_leader_missing(slot))
        may_ask = request(assembly, slot, 0, 0, now_us);
    for (uint32_t id = next_missing(slot, 1, end); may_ask && id <= end;) {
        uint32_t last = id;
        while (last < end && slot->states[last] == MISSING)
            last++;
        may_ask = request(assembly, slot, id, last, now_us);
        id = next_missing(slot, last + 1, end);
    }
    if (may_ask && is_cut && is_trailer_missing(slot))
        request(assembly, slot, slot->n_packets + 1, slot->n_packets + 1, now_us);
    slot->rounds++;
    slot->next_request_us = now_us + RESEND_US;
}

/* See to one frame; returns when it wants to be seen to next. */
static uint64_t tend(struct assembly *assembly, struct assembling *slot, uint64_t now_us)
{
    uint64_t silent_us = slot->last_packet_us + SILENCE_US;
    bool is_cut = slot->has_trailer || slot->frame->block_id != assembly->newest ||
                  now_us >= silent_us;
    uint32_t end = is_cut ? slot->n_packets : slot->highest;
    bool has_hole = is_leader_missing(slot) || next_missing(slot, 1, end) <= end;
    if (!has_hole && !(is_cut && is_trailer_missing(slot))) {
        slot->is_given_up = is_cut; /* all that is still missing was refused */
        slot->next_request_us = 0;
        return silent_us;
    }
    if (slot->next_request_us == 0)
        slot->next_request_us = now_us + REORDER_US;
    if (now_us < slot->next_request_us)
        return slot->next_request_us;
    if (slot->rounds < MAX_ROUNDS)
        request_missing(assembly, slot, is_cut, now_us);
    else
        slot->is_given_up = true;
    return slot->next_request_us;
}

uint64_t assembly_tick(struct assembly *assembly, uint64_t now_us)
{
    uint64_t next_us = UINT64_MAX;
    for (size_t i = 0; i < assembly->n_queued; i++) {
        uint64_t wanted_us = tend(assembly, assembly->queue[i], now_us);
        if (!assembly->queue[i]->is_given_up && wanted_us < next_us)
            next_us = wanted_us;
    }
    assembly_deliver_finished(assembly);
    return next_us;
}
