/* Feeds the producer's parsers with random and mutated packets: `fuzz SEED COUNT`.
 *
 * It ends with what was delivered, so that its caller can see that something happened. */
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "assembly.h"
#include "discovery.h"
#include "gvcp.h"
#include "wire.h"

enum { PACKET_SIZE = 136, CHUNK = PACKET_SIZE - GVSP_OVERHEAD, MAX_SIZE = 300 };
enum { WIDTH = 64, HEIGHT = 30, IMAGE_SIZE = WIDTH * HEIGHT };
enum { N_PACKETS = (IMAGE_SIZE + CHUNK - 1) / CHUNK };
enum { N_BUFFERS = 6 };

struct pool {
    struct frame frames[N_BUFFERS];
    struct frame *empty[N_BUFFERS];
    size_t n_empty, n_out;
    unsigned long n_complete, n_incomplete, n_requests;
};

static uint64_t state;

/* Numerical Recipes' 64-bit linear congruence; the high bits are good enough here. */
static uint32_t random32(void)
{
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(state >> 32);
}

static uint32_t below(uint32_t limit)
{
    return random32() % limit;
}

static void require(bool condition, const char *what)
{
    if (!condition) {
        printf("broken: %s\n", what);
        exit(1);
    }
}

static struct frame *take(void *context)
{
    struct pool *pool = context;
    if (!pool->n_empty || below(50) == 0)
        return NULL;
    pool->n_out++;
    return pool->empty[--pool->n_empty];
}

static void give_back(void *context, struct frame *frame)
{
    struct pool *pool = context;
    require(pool->n_out > 0, "a buffer comes back twice");
    pool->n_out--;
    pool->empty[pool->n_empty++] = frame;
}

static void deliver(void *context, struct frame *frame)
{
    struct pool *pool = context;
    require(frame->filled <= frame->size, "more bytes are filled than there are");
    require(frame->is_incomplete || frame->filled > 0, "a complete frame is empty");
    pool->n_complete += !frame->is_incomplete;
    pool->n_incomplete += frame->is_incomplete;
    give_back(context, frame);
}

static void request(void *context, uint16_t block_id, uint32_t first, uint32_t last)
{
    struct pool *pool = context;
    require(block_id != 0 && first <= last && last < 1u << 24, "a request makes no sense");
    pool->n_requests++;
}

static size_t make_leader(uint8_t *bytes, uint16_t block_id)
{
    store32(bytes + 4, GVSP_LEADER << 24);
    store16(bytes + 10, below(20) ? 1 : (uint16_t)random32());
    store32(bytes + 16, below(20) ? 100u * block_id : random32());
    store32(bytes + 20, below(20) ? 0x01080001 : random32());
    store32(bytes + 24, below(20) ? WIDTH : random32());
    store32(bytes + 28, below(20) ? HEIGHT : random32());
    return 44;
}

static size_t make_packet(uint8_t *bytes, uint16_t block_id, uint32_t packet_id)
{
    store16(bytes + 2, block_id);
    if (packet_id == 0)
        return make_leader(bytes, block_id);
    if (packet_id <= N_PACKETS) {
        store32(bytes + 4, GVSP_PAYLOAD << 24 | packet_id);
        return packet_id == N_PACKETS ? 8 + IMAGE_SIZE - (N_PACKETS - 1) * CHUNK : 8 + CHUNK;
    }
    store32(bytes + 4, GVSP_TRAILER << 24 | packet_id);
    store32(bytes + 12, HEIGHT);
    return 16;
}

static size_t mutate(uint8_t *bytes, size_t size)
{
    static const uint16_t statuses[] = {0x0100, 0x800c, 0x8010, 0x8011, 0x8012, 0x8014, 0x8fff};
    switch (below(6)) {
    case 0: /* flip bits of the header */
        bytes[below(8)] ^= (uint8_t)(1u << below(8));
        return size;
    case 1: /* flip bits anywhere */
        bytes[below((uint32_t)size)] ^= (uint8_t)(1u << below(8));
        return size;
    case 2: /* cut or lengthen */
        return below(MAX_SIZE);
    case 3: /* another packet's number */
        store32(bytes + 4, (load32(bytes + 4) & 0xff000000u) | (random32() & 0xffffffu));
        return size;
    case 4:
        store16(bytes, statuses[below(7)]);
        return size;
    default: /* noise from end to end */
        for (size_t i = 0; i < size; i++)
            bytes[i] = (uint8_t)random32();
        return size;
    }
}

static void feed_stream(struct assembly *assembly, unsigned long count)
{
    uint64_t now_us = 1;
    uint16_t block_id = 65500;
    uint32_t packet_id = 0;
    for (unsigned long i = 0; i < count; i++) {
        uint8_t bytes[MAX_SIZE] = {0};
        size_t size = make_packet(bytes, block_id, packet_id);
        if (below(20) == 0)
            size = mutate(bytes, size);
        uint8_t *exact = malloc(size ? size : 1);
        memcpy(exact, bytes, size);
        if (below(30))
            assembly_accept(assembly, exact, size, now_us);
        free(exact);
        now_us += below(200) ? below(300) : 50000;
        if (below(16) == 0)
            require(assembly_tick(assembly, now_us) > now_us, "the assembly never rests");
        if (++packet_id > N_PACKETS + 1) {
            packet_id = 0;
            block_id = below(300) ? (uint16_t)(block_id % 65535 + 1) : (uint16_t)random32();
        }
    }
}

static void feed_control(unsigned long count)
{
    unsigned long n_cameras = 0;
    for (unsigned long i = 0; i < count; i++) {
        size_t size = below(400);
        uint8_t *exact = malloc(size ? size : 1);
        for (size_t k = 0; k < size; k++)
            exact[k] = (uint8_t)random32();
        if (size >= 8 && below(4))
            store16(exact + 4, (uint16_t)(size - below(9)));
        struct gvcp_ack ack;
        struct camera camera;
        struct sockaddr_in from = {.sin_family = AF_INET};
        if (gvcp_parse_ack(exact, size, &ack)) {
            require(ack.payload + ack.payload_size <= exact + size, "the payload ends beyond");
            if (camera_parse(ack.payload, ack.payload_size, &from, &camera)) {
                require(strlen(camera.id) < sizeof camera.id, "the id is not ended");
                require(strlen(camera.vendor) <= 32, "the vendor is not ended");
                n_cameras++;
            }
        }
        free(exact);
    }
    printf("cameras %lu\n", n_cameras);
}

int main(int n_arguments, char **arguments)
{
    if (n_arguments != 3)
        return 2;
    state = strtoull(arguments[1], NULL, 10);
    unsigned long count = strtoul(arguments[2], NULL, 10);
    static struct pool pool;
    struct assembly_host host = {&pool, take, deliver, give_back, request};
    struct assembly *assembly = assembly_new(&host, PACKET_SIZE);
    for (size_t i = 0; i < N_BUFFERS; i++) {
        size_t size = i == 0 ? IMAGE_SIZE / 2 : IMAGE_SIZE + i % 2 * 777;
        pool.frames[i] = (struct frame){.base = malloc(size), .size = size};
        pool.empty[pool.n_empty++] = &pool.frames[i];
    }
    feed_stream(assembly, count);
    struct assembly_counts counts = *assembly_counts(assembly);
    assembly_free(assembly);
    require(pool.n_out == 0 && pool.n_empty == N_BUFFERS, "a buffer is lost");
    for (size_t i = 0; i < N_BUFFERS; i++)
        free(pool.frames[i].base);
    feed_control(count / 10);
    printf("complete %lu\nincomplete %lu\nrequests %lu\nmalformed %llu\nrefused %llu\n",
           pool.n_complete, pool.n_incomplete, pool.n_requests,
           (unsigned long long)counts.packets_malformed,
           (unsigned long long)counts.packets_refused);
    return 0;
}
