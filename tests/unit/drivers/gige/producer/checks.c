/* Checks of the producer's frame assembly, one a name: `checks NAME`. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "assembly.h"
#include "wire.h"

#define CHECK(condition)                                                                          \
    do {                                                                                          \
        if (!(condition)) {                                                                       \
            printf("%s:%d: not true: %s\n", __FILE__, __LINE__, #condition);                      \
            exit(1);                                                                              \
        }                                                                                         \
    } while (0)

enum { PACKET_SIZE = 136, CHUNK = PACKET_SIZE - GVSP_OVERHEAD };
enum { WIDTH = 64, HEIGHT = 15, IMAGE_SIZE = WIDTH * HEIGHT };          /* 960 bytes: */
enum { N_PACKETS = (IMAGE_SIZE + CHUNK - 1) / CHUNK };                  /* 9 of 100, 1 of 60 */
enum { MONO8 = 0x01080001, MAX_EVENTS = 1024 };

struct request {
    uint16_t block_id;
    uint32_t first, last;
};

struct bench {
    struct assembly *assembly;
    struct frame frames[20];
    struct frame *empty[20];
    size_t n_empty;
    struct frame *delivered[MAX_EVENTS];
    size_t n_delivered;
    struct request requests[MAX_EVENTS];
    size_t n_requests;
    uint64_t now_us;
};

static struct frame *take(void *context)
{
    struct bench *bench = context;
    return bench->n_empty ? bench->empty[--bench->n_empty] : NULL;
}

static void deliver(void *context, struct frame *frame)
{
    struct bench *bench = context;
    CHECK(bench->n_delivered < MAX_EVENTS);
    bench->delivered[bench->n_delivered++] = frame;
}

static void give_back(void *context, struct frame *frame)
{
    struct bench *bench = context;
    bench->empty[bench->n_empty++] = frame;
}

static void request(void *context, uint16_t block_id, uint32_t first, uint32_t last)
{
    struct bench *bench = context;
    CHECK(bench->n_requests < MAX_EVENTS);
    bench->requests[bench->n_requests++] = (struct request){block_id, first, last};
}

static struct bench *open_bench(size_t n_buffers, size_t buffer_size)
{
    struct bench *bench = calloc(1, sizeof *bench);
    struct assembly_host host = {bench, take, deliver, give_back, request};
    bench->assembly = assembly_new(&host, PACKET_SIZE);
    bench->now_us = 1000000;
    for (size_t i = 0; i < n_buffers; i++) {
        bench->frames[i] = (struct frame){.base = malloc(buffer_size), .size = buffer_size};
        memset(bench->frames[i].base, 0xee, buffer_size);
        bench->empty[bench->n_empty++] = &bench->frames[i];
    }
    return bench;
}

static void close_bench(struct bench *bench)
{
    assembly_free(bench->assembly);
    for (size_t i = 0; i < sizeof bench->frames / sizeof bench->frames[0]; i++)
        free(bench->frames[i].base);
    free(bench);
}

static uint8_t pixel(uint16_t block_id, size_t i)
{
    return (uint8_t)(block_id * 31 + i);
}

/* Send a copy of exactly its size, so that the address sanitizer sees any read beyond. */
static void send_bytes(struct bench *bench, const uint8_t *bytes, size_t size)
{
    uint8_t *copy = malloc(size ? size : 1);
    memcpy(copy, bytes, size);
    assembly_accept(bench->assembly, copy, size, bench->now_us);
    free(copy);
}

static void header(uint8_t *bytes, uint16_t status, uint16_t block_id, uint8_t format,
                   uint32_t packet_id)
{
    store16(bytes, status);
    store16(bytes + 2, block_id);
    store32(bytes + 4, (uint32_t)format << 24 | packet_id);
}

static void send_leader(struct bench *bench, uint16_t block_id, uint64_t ticks)
{
    uint8_t bytes[44] = {0};
    header(bytes, 0, block_id, GVSP_LEADER, 0);
    store16(bytes + 10, 1);
    store32(bytes + 12, (uint32_t)(ticks >> 32));
    store32(bytes + 16, (uint32_t)ticks);
    store32(bytes + 20, MONO8);
    store32(bytes + 24, WIDTH);
    store32(bytes + 28, HEIGHT);
    store32(bytes + 32, 8);
    store32(bytes + 36, 4);
    send_bytes(bench, bytes, sizeof bytes);
}

static void send_payload(struct bench *bench, uint16_t block_id, uint32_t packet_id)
{
    uint8_t bytes[8 + CHUNK];
    size_t offset = (packet_id - 1) * CHUNK;
    size_t size = packet_id == N_PACKETS ? IMAGE_SIZE - offset : CHUNK;
    header(bytes, 0, block_id, GVSP_PAYLOAD, packet_id);
    for (size_t i = 0; i < size; i++)
        bytes[8 + i] = pixel(block_id, offset + i);
    send_bytes(bench, bytes, 8 + size);
}

static void send_trailer(struct bench *bench, uint16_t block_id)
{
    uint8_t bytes[16] = {0};
    header(bytes, 0, block_id, GVSP_TRAILER, N_PACKETS + 1);
    store16(bytes + 10, 1);
    store32(bytes + 12, HEIGHT);
    send_bytes(bench, bytes, sizeof bytes);
}

static void send_error(struct bench *bench, uint16_t block_id, uint32_t packet_id,
                       uint16_t status)
{
    uint8_t bytes[8];
    header(bytes, status, block_id, GVSP_PAYLOAD, packet_id);
    send_bytes(bench, bytes, sizeof bytes);
}

/* A frame without the payload packets first..last. */
static void send_frame_without(struct bench *bench, uint16_t block_id, uint32_t first,
                               uint32_t last)
{
    send_leader(bench, block_id, 1000u * block_id);
    for (uint32_t id = 1; id <= N_PACKETS; id++)
        if (id < first || id > last)
            send_payload(bench, block_id, id);
    send_trailer(bench, block_id);
}

static void send_frame(struct bench *bench, uint16_t block_id)
{
    send_frame_without(bench, block_id, 0, 0);
}

static uint64_t wait_us(struct bench *bench, uint64_t us)
{
    bench->now_us += us;
    return assembly_tick(bench->assembly, bench->now_us);
}

/* Let time pass as the receiver does, until the assembly wants nothing more. */
static void wait_to_the_end(struct bench *bench)
{
    for (int i = 0; i < 1000; i++) {
        uint64_t next_us = assembly_tick(bench->assembly, bench->now_us);
        if (next_us == UINT64_MAX)
            return;
        CHECK(next_us > bench->now_us);
        bench->now_us = next_us;
    }
    CHECK(!"the assembly never comes to rest");
}

static void check_delivered(struct bench *bench, size_t i, uint16_t block_id, bool is_complete)
{
    CHECK(i < bench->n_delivered);
    struct frame *frame = bench->delivered[i];
    CHECK(frame->block_id == block_id);
    CHECK(frame->is_incomplete == !is_complete);
    for (size_t k = 0; is_complete && k < IMAGE_SIZE; k++)
        CHECK(frame->base[k] == pixel(block_id, k));
}

static void whole_frame(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_frame(bench, 1);
    check_delivered(bench, 0, 1, true);
    struct frame *frame = bench->delivered[0];
    CHECK(frame->filled == IMAGE_SIZE && frame->has_image && !frame->is_too_large);
    CHECK(frame->image.width == WIDTH && frame->image.height == HEIGHT);
    CHECK(frame->image.offset_x == 8 && frame->image.offset_y == 4);
    CHECK(frame->image.pixel_format == MONO8 && frame->image.timestamp_ticks == 1000);
    CHECK(frame->lines == HEIGHT && bench->n_requests == 0);
    CHECK(assembly_tick(bench->assembly, bench->now_us) == UINT64_MAX);
    close_bench(bench);
}

static void any_order(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_trailer(bench, 7);
    for (uint32_t id = N_PACKETS; id >= 1; id--)
        send_payload(bench, 7, id);
    CHECK(bench->n_delivered == 0);
    send_leader(bench, 7, 5);
    check_delivered(bench, 0, 7, true);
    close_bench(bench);
}

static void duplicates(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_leader(bench, 1, 1);
    for (int i = 0; i < N_PACKETS + 3; i++)
        send_payload(bench, 1, 1);
    send_trailer(bench, 1);
    CHECK(bench->n_delivered == 0);
    for (uint32_t id = 2; id <= N_PACKETS; id++)
        send_payload(bench, 1, id);
    check_delivered(bench, 0, 1, true);
    CHECK(bench->delivered[0]->filled == IMAGE_SIZE);
    send_payload(bench, 1, 3);
    CHECK(bench->n_delivered == 1);
    close_bench(bench);
}

static void block_id_wrap(void)
{
    struct bench *bench = open_bench(20, IMAGE_SIZE);
    CHECK(gvsp_block_distance(65535, 1) == 1 && gvsp_block_distance(1, 65535) == -1);
    CHECK(gvsp_block_distance(65530, 5) == 10 && gvsp_block_distance(3, 3) == 0);
    CHECK(gvsp_block_distance(1, 32768) == 32767 && gvsp_block_distance(1, 32769) == -32767);
    uint16_t block_id = 65532;
    for (size_t i = 0; i < 8; i++) {
        send_frame(bench, block_id);
        check_delivered(bench, i, block_id, true);
        block_id = block_id == 65535 ? 1 : (uint16_t)(block_id + 1);
    }
    CHECK(assembly_counts(bench->assembly)->skipped == 0);
    close_bench(bench);
}

static void skipped_blocks(void)
{
    struct bench *bench = open_bench(4, IMAGE_SIZE);
    send_frame(bench, 65534);
    send_frame(bench, 3);
    check_delivered(bench, 1, 3, true);
    CHECK(assembly_counts(bench->assembly)->skipped == 3); /* 65535, 1, 2 */
    close_bench(bench);
}

static void hole_is_requested(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_frame_without(bench, 9, 4, 6);
    wait_us(bench, 1);
    CHECK(bench->n_requests == 0); /* packets may yet overtake each other */
    wait_us(bench, 1000);
    CHECK(bench->n_requests == 1 && bench->requests[0].block_id == 9);
    CHECK(bench->requests[0].first == 4 && bench->requests[0].last == 6);
    wait_us(bench, 1000);
    CHECK(bench->n_requests == 1); /* the camera is given time */
    for (uint32_t id = 4; id <= 6; id++)
        send_payload(bench, 9, id);
    check_delivered(bench, 0, 9, true);
    CHECK(assembly_counts(bench->assembly)->packets_requested == 3);
    close_bench(bench);
}

static void hole_before_the_end(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_leader(bench, 1, 1);
    send_payload(bench, 1, 1);
    send_payload(bench, 1, 5);
    wait_us(bench, 0);
    wait_us(bench, 1000);
    CHECK(bench->n_requests == 1); /* what comes after packet 5 is not late */
    CHECK(bench->requests[0].first == 2 && bench->requests[0].last == 4);
    close_bench(bench);
}

static void lost_ends(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    for (uint32_t id = 1; id < N_PACKETS; id++)
        send_payload(bench, 2, id);
    wait_us(bench, 0);
    wait_us(bench, 1000);
    CHECK(bench->n_requests == 1 && bench->requests[0].last == 0); /* the leader */
    send_leader(bench, 2, 1);
    wait_us(bench, 30000);
    wait_us(bench, 1000);
    CHECK(bench->n_requests == 3);
    CHECK(bench->requests[1].first == N_PACKETS && bench->requests[1].last == N_PACKETS);
    CHECK(bench->requests[2].first == N_PACKETS + 1); /* the trailer */
    send_payload(bench, 2, N_PACKETS);
    send_trailer(bench, 2);
    check_delivered(bench, 0, 2, true);
    close_bench(bench);
}

static void image_without_trailer(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_leader(bench, 1, 1);
    for (uint32_t id = 1; id <= N_PACKETS; id++)
        send_payload(bench, 1, id);
    wait_to_the_end(bench);
    CHECK(bench->n_requests > 0);
    check_delivered(bench, 0, 1, true); /* nothing of the image is missing */
    close_bench(bench);
}

static void frames_in_order(void)
{
    struct bench *bench = open_bench(4, IMAGE_SIZE);
    send_frame_without(bench, 1, 2, 2);
    send_frame(bench, 2);
    send_frame_without(bench, 3, 5, 5);
    CHECK(bench->n_delivered == 0);
    send_payload(bench, 3, 5);
    CHECK(bench->n_delivered == 0);
    send_payload(bench, 1, 2);
    CHECK(bench->n_delivered == 3);
    for (size_t i = 0; i < 3; i++)
        check_delivered(bench, i, (uint16_t)(i + 1), true);
    close_bench(bench);
}

static void silence_is_given_up(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_frame_without(bench, 1, 3, 3);
    wait_to_the_end(bench);
    CHECK(bench->n_requests == 6); /* and no more */
    check_delivered(bench, 0, 1, false);
    CHECK(bench->delivered[0]->filled == IMAGE_SIZE - CHUNK);
    CHECK(bench->now_us < 1000000 + 200000);
    CHECK(assembly_counts(bench->assembly)->incomplete == 1);
    send_frame(bench, 2);
    check_delivered(bench, 1, 2, true);
    close_bench(bench);
}

static void refused_packet(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_frame_without(bench, 1, 3, 3);
    wait_us(bench, 0);
    wait_us(bench, 1000);
    CHECK(bench->n_requests == 1);
    send_error(bench, 1, 3, GVSP_STATUS_UNAVAILABLE);
    wait_us(bench, 1);
    check_delivered(bench, 0, 1, false); /* at once */
    CHECK(assembly_counts(bench->assembly)->packets_refused == 1);
    close_bench(bench);
}

static void previous_packets_removed(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_frame_without(bench, 1, 2, 5);
    send_error(bench, 1, 4, GVSP_STATUS_PREVIOUS_REMOVED);
    wait_us(bench, 0);
    wait_us(bench, 1000);
    CHECK(bench->n_requests == 1 && bench->requests[0].first == 5);
    send_payload(bench, 1, 5);
    wait_us(bench, 1);
    check_delivered(bench, 0, 1, false);
    close_bench(bench);
}

static void not_yet_available(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    send_frame_without(bench, 1, 3, 3);
    wait_us(bench, 0);
    wait_us(bench, 1000);
    send_error(bench, 1, 3, GVSP_STATUS_NOT_YET_AVAILABLE);
    wait_us(bench, 20000);
    CHECK(bench->n_requests == 2 && bench->n_delivered == 0);
    send_payload(bench, 1, 3);
    check_delivered(bench, 0, 1, true);
    CHECK(assembly_counts(bench->assembly)->packets_refused == 0);
    close_bench(bench);
}

static void requests_are_limited(void)
{
    enum { HUGE_SIZE = CHUNK * 1000, N_HOLES = 499 };
    struct bench *bench = open_bench(2, HUGE_SIZE);
    uint8_t bytes[8 + CHUNK] = {0};
    for (uint32_t id = 1; id <= 2 * N_HOLES + 1; id += 2) { /* each second packet is lost */
        header(bytes, 0, 1, GVSP_PAYLOAD, id);
        send_bytes(bench, bytes, sizeof bytes);
    }
    wait_us(bench, 0);
    wait_us(bench, 1000);
    CHECK(bench->n_requests > 0 && bench->n_requests <= 66); /* what the stream may save up */
    wait_to_the_end(bench);
    CHECK(assembly_counts(bench->assembly)->packets_requested <= 500); /* half of the frame */
    check_delivered(bench, 0, 1, false);
    close_bench(bench);
}

static void no_buffer(void)
{
    struct bench *bench = open_bench(1, IMAGE_SIZE);
    send_frame(bench, 1);
    send_frame(bench, 2);
    CHECK(bench->n_delivered == 1);
    CHECK(assembly_counts(bench->assembly)->underruns == 1);
    give_back(bench, bench->delivered[0]);
    send_frame(bench, 3);
    check_delivered(bench, 1, 3, true);
    CHECK(assembly_counts(bench->assembly)->skipped == 0);
    CHECK(assembly_counts(bench->assembly)->started == 3);
    close_bench(bench);
}

static void buffer_too_small(void)
{
    struct bench *bench = open_bench(2, 3 * CHUNK + 10);
    send_frame(bench, 1);
    wait_to_the_end(bench);
    check_delivered(bench, 0, 1, false);
    CHECK(bench->delivered[0]->is_too_large);
    CHECK(bench->delivered[0]->filled <= 3 * CHUNK + 10);
    close_bench(bench);
}

static void larger_buffer(void)
{
    struct bench *bench = open_bench(2, 3 * IMAGE_SIZE);
    send_frame(bench, 1);
    check_delivered(bench, 0, 1, true);
    CHECK(bench->delivered[0]->base[IMAGE_SIZE] == 0xee);
    close_bench(bench);
}

static void malformed(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    uint8_t bytes[8 + CHUNK + 1] = {0};
    for (size_t size = 0; size < 8; size++)
        send_bytes(bench, bytes, size);
    header(bytes, 0, 0, GVSP_PAYLOAD, 1); /* block 0 */
    send_bytes(bench, bytes, 8 + CHUNK);
    header(bytes, 0, 1, 0x80 | GVSP_PAYLOAD, 1); /* extended ids */
    send_bytes(bench, bytes, 8 + CHUNK);
    header(bytes, 0, 1, 4, 1); /* all-in */
    send_bytes(bench, bytes, 8 + CHUNK);
    header(bytes, 0, 1, GVSP_PAYLOAD, 0); /* payload before the first */
    send_bytes(bench, bytes, 8 + CHUNK);
    header(bytes, 0, 1, GVSP_LEADER, 0); /* cut short */
    send_bytes(bench, bytes, 19);
    store16(bytes + 10, 1);
    send_bytes(bench, bytes, 43);
    CHECK(bench->n_empty == 2); /* none of them began a frame */
    send_leader(bench, 1, 1);
    header(bytes, 0, 1, GVSP_PAYLOAD, 1); /* longer than a packet can be */
    send_bytes(bench, bytes, 8 + CHUNK + 1);
    CHECK(assembly_counts(bench->assembly)->packets_malformed == 15);
    close_bench(bench);
}

static void short_packets(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    uint8_t bytes[8 + CHUNK] = {0};
    send_leader(bench, 1, 1000);
    header(bytes, 0, 1, GVSP_PAYLOAD, 2);
    send_bytes(bench, bytes, 8 + CHUNK - 1);
    header(bytes, 0, 1, GVSP_PAYLOAD, N_PACKETS);
    send_bytes(bench, bytes, 8 + 59);
    CHECK(assembly_counts(bench->assembly)->packets_malformed == 2);
    send_frame(bench, 1);
    check_delivered(bench, 0, 1, true);
    close_bench(bench);
}

static void padded_last_packet(void)
{
    struct bench *bench = open_bench(2, IMAGE_SIZE);
    uint8_t bytes[8 + CHUNK] = {0};
    send_leader(bench, 1, 1);
    for (uint32_t id = 1; id < N_PACKETS; id++)
        send_payload(bench, 1, id);
    header(bytes, 0, 1, GVSP_PAYLOAD, N_PACKETS);
    for (size_t i = 0; i < IMAGE_SIZE % CHUNK; i++)
        bytes[8 + i] = pixel(1, IMAGE_SIZE - IMAGE_SIZE % CHUNK + i);
    send_bytes(bench, bytes, 8 + CHUNK);
    send_trailer(bench, 1);
    check_delivered(bench, 0, 1, true);
    close_bench(bench);
}

static void camera_restarts(void)
{
    struct bench *bench = open_bench(8, IMAGE_SIZE);
    uint64_t ticks = 10;
    for (size_t i = 0; i < 3; i++) { /* single frames: the id is 1 each time */
        send_leader(bench, 1, ticks += 10);
        for (uint32_t id = 1; id <= N_PACKETS; id++)
            send_payload(bench, 1, id);
        send_trailer(bench, 1);
        check_delivered(bench, i, 1, true);
    }
    send_leader(bench, 1, ticks); /* the same once more is only late */
    CHECK(bench->n_delivered == 3 && assembly_counts(bench->assembly)->started == 3);
    send_leader(bench, 2, ticks += 10);
    send_leader(bench, 1, ticks += 10); /* anew while 2 is under way */
    check_delivered(bench, 3, 2, false);
    close_bench(bench);
}

static void restart_without_clock(void)
{
    struct bench *bench = open_bench(8, IMAGE_SIZE);
    send_leader(bench, 500, 0);
    send_leader(bench, 1, 0);
    check_delivered(bench, 0, 500, false);
    close_bench(bench);
}

static void stray_packet(void)
{
    struct bench *bench = open_bench(4, IMAGE_SIZE);
    send_frame(bench, 1);
    send_payload(bench, 30000, 1);
    send_trailer(bench, 20000);
    send_error(bench, 5, 1, GVSP_STATUS_UNAVAILABLE);
    send_frame(bench, 2);
    check_delivered(bench, 1, 2, true);
    CHECK(assembly_counts(bench->assembly)->skipped == 0);
    close_bench(bench);
}

static void stop_gives_back(void)
{
    struct bench *bench = open_bench(4, IMAGE_SIZE);
    struct assembly_host host = {bench, take, deliver, give_back, request};
    send_leader(bench, 1, 1);
    send_leader(bench, 2, 2);
    CHECK(bench->n_empty == 2);
    assembly_free(bench->assembly);
    CHECK(bench->n_empty == 4);
    bench->assembly = assembly_new(&host, PACKET_SIZE);
    send_frame(bench, 1); /* the next acquisition remembers nothing */
    check_delivered(bench, 0, 1, true);
    close_bench(bench);
}

static void streams_are_apart(void)
{
    struct bench *one = open_bench(2, IMAGE_SIZE), *other = open_bench(2, IMAGE_SIZE);
    send_frame(one, 5);
    send_frame(other, 5);
    send_frame(other, 4); /* late there, and never sent here */
    check_delivered(one, 0, 5, true);
    check_delivered(other, 0, 5, true);
    CHECK(one->n_delivered == 1 && other->n_delivered == 1);
    close_bench(one);
    close_bench(other);
}

static void image_sizes(void)
{
    struct gvsp_image image = {.width = 1360, .height = 1024, .pixel_format = MONO8};
    CHECK(gvsp_image_bytes(&image) == 1360 * 1024);
    image.pixel_format = 0x01100005; /* Mono12 */
    CHECK(gvsp_image_bytes(&image) == 2 * 1360 * 1024);
    image.pixel_format = 0x010c0006; /* Mono12Packed: two pixels in three bytes */
    CHECK(gvsp_image_bytes(&image) == 1360 * 1024 / 2 * 3);
    image.width = 3, image.height = 1;
    CHECK(gvsp_image_bytes(&image) == 5);
    image.padding_x = 2, image.padding_y = 1;
    CHECK(gvsp_image_bytes(&image) == 5 + 2 + 1);
    image.width = image.height = UINT32_MAX;
    CHECK(gvsp_image_bytes(&image) == UINT64_MAX);
}

#define NAMED(function) {#function, function}

static const struct {
    const char *name;
    void (*run)(void);
} CHECKS[] = {
    NAMED(whole_frame),
    NAMED(any_order),
    NAMED(duplicates),
    NAMED(block_id_wrap),
    NAMED(skipped_blocks),
    NAMED(hole_is_requested),
    NAMED(hole_before_the_end),
    NAMED(lost_ends),
    NAMED(image_without_trailer),
    NAMED(frames_in_order),
    NAMED(silence_is_given_up),
    NAMED(refused_packet),
    NAMED(previous_packets_removed),
    NAMED(not_yet_available),
    NAMED(requests_are_limited),
    NAMED(no_buffer),
    NAMED(buffer_too_small),
    NAMED(larger_buffer),
    NAMED(malformed),
    NAMED(short_packets),
    NAMED(padded_last_packet),
    NAMED(camera_restarts),
    NAMED(restart_without_clock),
    NAMED(stray_packet),
    NAMED(stop_gives_back),
    NAMED(streams_are_apart),
    NAMED(image_sizes),
};

int main(int n_arguments, char **arguments)
{
    for (size_t i = 0; n_arguments == 2 && i < sizeof CHECKS / sizeof CHECKS[0]; i++) {
        if (strcmp(CHECKS[i].name, arguments[1]))
            continue;
        CHECKS[i].run();
        printf("ok %s\n", CHECKS[i].name);
        return 0;
    }
    printf("usage: %s NAME\n", arguments[0]);
    return 2;
}
