/* Write a navigation core for tronlab in C or C++: this one file, nothing else.
 *
 *     #include "tronlab_core.h"
 *
 *     static void locate(void *state, const tlc_frame *frame, tlc_result *result) { ... }
 *
 *     int main(int argc, char **argv)
 *     {
 *         tlc_core core = tlc_core_named("mine", "1.0");
 *         core.locate = locate;
 *         return tlc_serve(&core, argc, argv);
 *     }
 *
 * The program then speaks protocol 1 (docs/reference/core_protocol.md) on its standard input and
 * output, or, started with "--listen [HOST:]PORT", to whoever connects. What it prints goes to
 * standard error, so printf does no harm.
 *
 * C99 and C++17, POSIX, either byte order. Include it before the system's headers. Numbers are read
 * and written in the "C" locale: do not call setlocale for LC_NUMERIC. One thread: the callbacks
 * are called one after the other.
 */
#ifndef TRONLAB_CORE_H
#define TRONLAB_CORE_H

#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200809L
#endif

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

#define TLC_PROTOCOL 1
#define TLC_REASON_BYTES 256
#define TLC_N_DISTORTION 8
#define TLC_MAX_HEADER_BYTES (UINT32_C(1) << 20)
#define TLC_MAX_PAYLOAD_BYTES (UINT64_C(1) << 32)
#define TLC_MAX_DEPTH 32

/* ---------------------------------------------------------------- what a core sees and answers */

/* A piece of JSON that was found to be well formed; at is NULL if there is none. */
typedef struct tlc_json {
    const char *at, *end;
} tlc_json;

/* A two-dimensional array in somebody else's memory; read it with tlc_at. */
typedef struct tlc_array {
    const unsigned char *bytes; /* NULL if there is none */
    size_t rows, columns;
    size_t item_bytes; /* 1, 2: whole numbers from 0; 4, 8: floating point */
} tlc_array;

/* trs_from_cam: where the camera is in the frame of the terrain model, and how it is turned. */
typedef struct tlc_pose {
    double position_m[3];
    double quaternion_xyzw[4];
} tlc_pose;

/* Pixel (0, 0) has its centre at uv (0, 0). Distortion: k1, k2, p1, p2, k3, k4, k5, k6. */
typedef struct tlc_camera {
    int width_px, height_px;
    double fx_px, fy_px, cx_px, cy_px;
    double distortion[TLC_N_DISTORTION];
} tlc_camera;

/* The terrain as rendered at a known pose. */
typedef struct tlc_reference {
    tlc_pose pose;
    tlc_array image;
    tlc_array depth_m; /* along the optical axis; NaN where there is no terrain */
    tlc_array mask;    /* not 0 where the model is seen */
} tlc_reference;

/* What a core is told once, valid until the next setup. */
typedef struct tlc_setup {
    tlc_camera camera;
    const tlc_reference *references; /* none unless the core wants them */
    size_t n_references;
    tlc_json settings; /* an object: read it with tlc_json_get and tlc_json_number */
    uint64_t seed;     /* of every random number the core draws */
} tlc_setup;

/* One image, valid until locate returns. */
typedef struct tlc_frame {
    uint64_t number; /* of the shot in its dataset, from 0 */
    double time_s;   /* of the exposure, Unix time; NaN if nobody knows it */
    tlc_array image;
    tlc_array mask; /* not 0 where features may be used */
    bool has_prior;
    tlc_pose prior;
    double prior_covariance[36]; /* of (rotation vector, translation), in trs, rad and m */
} tlc_frame;

/* An answer. It begins as "no pose" without a reason; a core fills in what it has. */
typedef struct tlc_result {
    bool has_pose;
    tlc_pose pose;
    bool has_covariance;
    double covariance[36];         /* like prior_covariance */
    char reason[TLC_REASON_BYTES]; /* why there is no pose; snprintf into it */
    long n_features, n_matches, n_inliers;
    double time_detect_s, time_match_s, time_pose_s;
    const double *uv_inliers; /* n_inliers times u, v; NULL if not known */
} tlc_result;

/* A core: what it is called, what it needs, what it does. Callbacks but locate may be NULL. */
typedef struct tlc_core {
    const char *name, *version;
    const char *identity; /* changes whenever answers may, a hash of the build say; may be NULL */
    bool sequential;      /* keeps state from frame to frame: it gets all frames in order */
    bool references;      /* wants the reference views */
    void *state;          /* handed to every callback */
    /* False, with a reason, if the core cannot work with this. Called again on a new connection. */
    bool (*setup)(void *state, const tlc_setup *setup, char reason[TLC_REASON_BYTES]);
    void (*locate)(void *state, const tlc_frame *frame, tlc_result *result);
    void (*reset)(void *state); /* the next frame begins a sequence */
} tlc_core;

static inline tlc_core tlc_core_named(const char *name, const char *version)
{
    tlc_core core;
    memset(&core, 0, sizeof core);
    core.name = name;
    core.version = version;
    return core;
}

/* ----------------------------------------------------------------------------- arrays and JSON */

/* Give the little-endian whole number of n bytes, whatever this machine's byte order. */
static inline uint64_t tlc_little_endian(const unsigned char *bytes, size_t n)
{
    uint64_t value = 0;
    while (n-- > 0) {
        value = value << 8 | bytes[n];
    }
    return value;
}

static inline void tlc_put_little_endian(unsigned char *bytes, uint64_t value, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        bytes[i] = (unsigned char)(value >> 8 * i & 0xff);
    }
}

/* Give one value; row and column must be inside. */
static inline double tlc_at(const tlc_array *array, size_t row, size_t column)
{
    const size_t n = array->item_bytes;
    const unsigned char *item = array->bytes + (row * array->columns + column) * n;
    if (n == 1) {
        return item[0];
    }
    const uint64_t bits = tlc_little_endian(item, n);
    if (n == 2) {
        return (double)bits;
    }
    if (n == 4) {
        const uint32_t half = (uint32_t)bits;
        float value;
        memcpy(&value, &half, sizeof value);
        return (double)value;
    }
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline const char *tlc_skip_space(const char *at, const char *end)
{
    while (at < end && (*at == ' ' || *at == '\t' || *at == '\n' || *at == '\r')) {
        at++;
    }
    return at;
}

static inline const char *tlc_skip_digits(const char *at, const char *end)
{
    const char *begin = at;
    while (at < end && *at >= '0' && *at <= '9') {
        at++;
    }
    return at > begin ? at : NULL;
}

static inline const char *tlc_skip_number(const char *at, const char *end)
{
    at += *at == '-';
    if (at < end && *at == '0') {
        at++;
    } else if (!(at = tlc_skip_digits(at, end))) {
        return NULL;
    }
    if (at < end && *at == '.' && !(at = tlc_skip_digits(at + 1, end))) {
        return NULL;
    }
    if (at < end && (*at == 'e' || *at == 'E')) {
        at++;
        at += at < end && (*at == '+' || *at == '-');
        at = tlc_skip_digits(at, end);
    }
    return at;
}

/* Read the four hexadecimal digits of an escape; -1 if they are none. */
static inline long tlc_hex4(const char *at, const char *end)
{
    long code = 0;
    if (end - at < 4) {
        return -1;
    }
    for (int i = 0; i < 4; i++) {
        const char *digits = "0123456789abcdef";
        const char digit = at[i] >= 'A' && at[i] <= 'F' ? (char)(at[i] - 'A' + 'a') : at[i];
        const char *found = digit ? strchr(digits, digit) : NULL;
        if (!found) {
            return -1;
        }
        code = code * 16 + (long)(found - digits);
    }
    return code;
}

static inline const char *tlc_skip_string(const char *at, const char *end)
{
    for (at++; at < end && *at != '"'; at++) {
        if ((unsigned char)*at < 0x20) {
            return NULL;
        }
        if (*at != '\\') {
            continue;
        }
        if (++at >= end || !*at || !strchr("\"\\/bfnrtu", *at)) {
            return NULL;
        }
        if (*at == 'u') {
            if (tlc_hex4(at + 1, end) < 0) {
                return NULL;
            }
            at += 4;
        }
    }
    return at < end ? at + 1 : NULL;
}

static inline const char *tlc_skip_value(const char *at, const char *end, int depth);

/* Skip an object or an array, at its bracket. */
static inline const char *tlc_skip_list(const char *at, const char *end, int depth)
{
    const bool is_object = *at == '{';
    const char close = is_object ? '}' : ']';
    at = tlc_skip_space(at + 1, end);
    if (at < end && *at == close) {
        return at + 1;
    }
    while (at < end) {
        if (is_object) {
            if (*at != '"' || !(at = tlc_skip_string(at, end))) {
                return NULL;
            }
            at = tlc_skip_space(at, end);
            if (at >= end || *at++ != ':') {
                return NULL;
            }
        }
        if (!(at = tlc_skip_value(at, end, depth + 1))) {
            return NULL;
        }
        at = tlc_skip_space(at, end);
        if (at < end && *at == close) {
            return at + 1;
        }
        if (at >= end || *at != ',') {
            return NULL;
        }
        at = tlc_skip_space(at + 1, end);
    }
    return NULL;
}

/* Give the end of the value that begins at or after a place; NULL if it is not JSON. */
static inline const char *tlc_skip_value(const char *at, const char *end, int depth)
{
    static const char *const words[] = {"true", "false", "null"};
    at = tlc_skip_space(at, end);
    if (at >= end || depth > TLC_MAX_DEPTH) {
        return NULL;
    }
    if (*at == '{' || *at == '[') {
        return tlc_skip_list(at, end, depth);
    }
    if (*at == '"') {
        return tlc_skip_string(at, end);
    }
    for (size_t i = 0; i < 3; i++) {
        const size_t n = strlen(words[i]);
        if ((size_t)(end - at) >= n && !memcmp(at, words[i], n)) {
            return at + n;
        }
    }
    return tlc_skip_number(at, end);
}

/* Check a whole text, n bytes with a zero behind them. */
static inline tlc_json tlc_json_parse(const char *text, size_t n)
{
    const tlc_json none = {NULL, NULL};
    tlc_json root;
    root.at = tlc_skip_space(text, text + n);
    root.end = tlc_skip_value(text, text + n, 0);
    return root.end && tlc_skip_space(root.end, text + n) == text + n ? root : none;
}

/* Read a string, decoded to UTF-8; false if it is none, does not fit, or holds a zero. */
static inline bool tlc_json_string(tlc_json value, char *text, size_t size)
{
    size_t n = 0;
    if (!value.at || *value.at != '"') {
        return false;
    }
    for (const char *at = value.at + 1; at < value.end - 1; at++) {
        unsigned long code = (unsigned char)*at;
        bool is_escaped = false;
        if (*at == '\\') {
            static const char names[] = "bfnrt", codes[] = "\b\f\n\r\t";
            const char *name = strchr(names, *++at);
            code = name ? (unsigned char)codes[name - names] : (unsigned char)*at;
            is_escaped = *at == 'u';
        }
        if (is_escaped) {
            code = (unsigned long)tlc_hex4(at + 1, value.end);
            at += 4;
            if (code >= 0xd800 && code < 0xdc00 && value.end - at > 6 && at[1] == '\\'
                && at[2] == 'u') {
                const long low = tlc_hex4(at + 3, value.end);
                if (low >= 0xdc00 && low < 0xe000) {
                    code = 0x10000 + ((code - 0xd800) << 10) + ((unsigned long)low - 0xdc00);
                    at += 6;
                }
            }
        }
        const size_t n_more = !is_escaped || code < 0x80 ? 0 : code < 0x800 ? 1
                              : code < 0x10000           ? 2 : 3;
        if (!code || n + n_more + 1 >= size) {
            return false;
        }
        static const unsigned char first[] = {0x00, 0xc0, 0xe0, 0xf0};
        text[n++] = (char)(unsigned char)(first[n_more] | code >> 6 * n_more);
        for (size_t i = n_more; i-- > 0;) {
            text[n++] = (char)(unsigned char)(0x80 | (code >> 6 * i & 0x3f));
        }
    }
    text[n] = '\0';
    return true;
}

/* Step through an object or an array: *at begins NULL; false at the end. */
static inline bool tlc_json_next(tlc_json list, const char **at, tlc_json *key, tlc_json *value)
{
    if (!list.at || (*list.at != '{' && *list.at != '[')) {
        return false;
    }
    const char *next = tlc_skip_space(*at ? *at : list.at + 1, list.end);
    if (*next == ',') {
        next = tlc_skip_space(next + 1, list.end);
    }
    if (next >= list.end - 1) {
        return false;
    }
    key->at = key->end = NULL;
    if (*list.at == '{') {
        key->at = next;
        key->end = tlc_skip_string(next, list.end);
        next = tlc_skip_space(key->end, list.end) + 1;
    }
    value->at = tlc_skip_space(next, list.end);
    value->end = *at = tlc_skip_value(next, list.end, 0);
    return true;
}

/* Look up a key; what is no object has none. */
static inline tlc_json tlc_json_get(tlc_json object, const char *wanted)
{
    const tlc_json none = {NULL, NULL};
    const char *at = NULL;
    tlc_json key, value;
    char name[128];
    while (tlc_json_next(object, &at, &key, &value)) {
        if (tlc_json_string(key, name, sizeof name) && !strcmp(name, wanted)) {
            return value;
        }
    }
    return none;
}

static inline bool tlc_json_number(tlc_json value, double *number)
{
    if (!value.at || (*value.at != '-' && (*value.at < '0' || *value.at > '9'))) {
        return false;
    }
    *number = strtod(value.at, NULL);
    return true;
}

/* Read a whole number from 0 to 2^53. */
static inline bool tlc_json_count(tlc_json value, uint64_t *count)
{
    double number;
    if (!tlc_json_number(value, &number) || !(number >= 0 && number <= 9007199254740992.0)
        || number != floor(number)) {
        return false;
    }
    *count = (uint64_t)number;
    return true;
}

static inline bool tlc_json_bool(tlc_json value, bool *is_true)
{
    if (!value.at || (*value.at != 't' && *value.at != 'f')) {
        return false;
    }
    *is_true = *value.at == 't';
    return true;
}

/* Read an array of numbers; gives how many there are, or -1 if more than n_max or not numbers. */
static inline int tlc_json_numbers(tlc_json value, double *numbers, int n_max)
{
    const char *at = NULL;
    tlc_json key, item;
    int n = 0;
    if (!value.at || *value.at != '[') {
        return -1;
    }
    while (tlc_json_next(value, &at, &key, &item)) {
        if (n >= n_max || !tlc_json_number(item, &numbers[n++])) {
            return -1;
        }
    }
    return n;
}

/* -------------------------------------------------------------------------------- camera maths */

/* Give the rotation matrix of a unit quaternion, row-major: p_trs = R p_cam + position. */
static inline void tlc_rotation(const double quaternion_xyzw[4], double matrix[9])
{
    const double x = quaternion_xyzw[0], y = quaternion_xyzw[1], z = quaternion_xyzw[2],
                 w = quaternion_xyzw[3];
    const double rows[9] = {
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w),     2 * (x * z + y * w),
        2 * (x * y + z * w),     1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w),     2 * (y * z + x * w),     1 - 2 * (x * x + y * y),
    };
    memcpy(matrix, rows, sizeof rows);
}

/* Take a point from cam to trs. */
static inline void tlc_to_trs(const tlc_pose *pose, const double p_cam[3], double p_trs[3])
{
    double r[9];
    tlc_rotation(pose->quaternion_xyzw, r);
    for (int i = 0; i < 3; i++) {
        p_trs[i] = r[3 * i] * p_cam[0] + r[3 * i + 1] * p_cam[1] + r[3 * i + 2] * p_cam[2]
                   + pose->position_m[i];
    }
}

/* Take a point from trs to cam. */
static inline void tlc_to_cam(const tlc_pose *pose, const double p_trs[3], double p_cam[3])
{
    double r[9], d[3];
    tlc_rotation(pose->quaternion_xyzw, r);
    for (int i = 0; i < 3; i++) {
        d[i] = p_trs[i] - pose->position_m[i];
    }
    for (int i = 0; i < 3; i++) {
        p_cam[i] = r[i] * d[0] + r[3 + i] * d[1] + r[6 + i] * d[2];
    }
}

/* Distort normalised image coordinates (Brown 1966, with OpenCV's denominator k4 to k6). */
static inline void tlc_distort(const tlc_camera *camera, double x, double y, double xy[2])
{
    const double *d = camera->distortion;
    const double r2 = x * x + y * y;
    const double radial = (1 + r2 * (d[0] + r2 * (d[1] + r2 * d[4])))
                          / (1 + r2 * (d[5] + r2 * (d[6] + r2 * d[7])));
    xy[0] = x * radial + 2 * d[2] * x * y + d[3] * (r2 + 2 * x * x);
    xy[1] = y * radial + d[2] * (r2 + 2 * y * y) + 2 * d[3] * x * y;
}

/* Give the image position of a point in cam; its z must be positive. */
static inline void tlc_project(const tlc_camera *camera, const double p_cam[3], double uv[2])
{
    tlc_distort(camera, p_cam[0] / p_cam[2], p_cam[1] / p_cam[2], uv);
    uv[0] = camera->fx_px * uv[0] + camera->cx_px;
    uv[1] = camera->fy_px * uv[1] + camera->cy_px;
}

/* Give the direction (x, y, 1) in cam of an image position, by fixed-point iteration. */
static inline void tlc_ray(const tlc_camera *camera, double u, double v, double ray_cam[3])
{
    const double goal[2] = {(u - camera->cx_px) / camera->fx_px,
                            (v - camera->cy_px) / camera->fy_px};
    double x = goal[0], y = goal[1], xy[2];
    for (int step = 0; step < 20; step++) {
        tlc_distort(camera, x, y, xy);
        x += goal[0] - xy[0];
        y += goal[1] - xy[1];
    }
    ray_cam[0] = x;
    ray_cam[1] = y;
    ray_cam[2] = 1;
}

/* ------------------------------------------------------------------------------------ messages */

typedef struct tlc_message {
    tlc_json header;
    char *text;
    unsigned char *payload;
    size_t payload_bytes;
    bool is_end; /* there is no message: the stream ended after the last one */
} tlc_message;

/* One conversation: where bytes come from and go to, and what was told so far. */
typedef struct tlc_link {
    int in, out;
    bool can_share_memory;
    void *shared;
    size_t shared_bytes;
    tlc_message hello;
    tlc_message *reference_messages;
    tlc_reference *references;
    size_t n_reference_messages;
    tlc_setup setup;
    bool is_ready;
} tlc_link;

static inline bool tlc_complain(const char *what)
{
    fprintf(stderr, "tronlab_core: %s\n", what);
    return false;
}

/* Read n bytes and put a zero behind them. The memory grows as bytes arrive, so that a length that
 * lies costs none. NULL at the end of the stream; *n_read tells how far it came. */
static inline unsigned char *tlc_read_bytes(int file, uint64_t n, size_t *n_read)
{
    size_t room = 0;
    unsigned char *bytes = NULL;
    *n_read = 0;
    do {
        if (*n_read == room) {
            const uint64_t wanted = room ? 2 * (uint64_t)room : UINT64_C(1) << 20;
            room = (size_t)(wanted < n ? wanted : n);
            unsigned char *more = (unsigned char *)realloc(bytes, room + 1);
            if (!more) {
                free(bytes);
                return NULL;
            }
            bytes = more;
        }
        const ssize_t got = *n_read < n ? read(file, bytes + *n_read, room - *n_read) : 0;
        if (got < 0 && errno == EINTR) {
            continue;
        }
        if (got <= 0 && *n_read < n) {
            free(bytes);
            return NULL;
        }
        *n_read += (size_t)got;
    } while (*n_read < n);
    bytes[n] = '\0';
    return bytes;
}

static inline void tlc_free_message(tlc_message *message)
{
    free(message->text);
    free(message->payload);
    memset(message, 0, sizeof *message);
}

/* Read a message; false at the end of the stream and, with a complaint, if it is none. */
static inline bool tlc_read_message(int file, tlc_message *message)
{
    size_t n_read;
    memset(message, 0, sizeof *message);
    unsigned char *start = tlc_read_bytes(file, 16, &n_read);
    if (!start) {
        message->is_end = !n_read;
        return n_read ? tlc_complain("the stream ended within a message") : false;
    }
    const bool is_ours = !memcmp(start, "TLC1", 4);
    const uint64_t n_header = tlc_little_endian(start + 4, 4);
    const uint64_t n_payload = tlc_little_endian(start + 8, 8);
    free(start);
    if (!is_ours) {
        return tlc_complain("what came is no message: it does not begin with TLC1");
    }
    if (n_header > TLC_MAX_HEADER_BYTES || n_payload > TLC_MAX_PAYLOAD_BYTES
        || n_payload >= SIZE_MAX) {
        return tlc_complain("a message is longer than the protocol allows");
    }
    message->text = (char *)tlc_read_bytes(file, n_header, &n_read);
    message->payload = message->text ? tlc_read_bytes(file, n_payload, &message->payload_bytes)
                                     : NULL;
    if (!message->payload) {
        tlc_free_message(message);
        return tlc_complain("the stream ended within a message");
    }
    message->header = tlc_json_parse(message->text, (size_t)n_header);
    if (!message->header.at || *message->header.at != '{') {
        tlc_free_message(message);
        return tlc_complain("the header of a message is no JSON object");
    }
    return true;
}

static inline bool tlc_write_bytes(int file, const void *bytes, size_t n)
{
    const unsigned char *at = (const unsigned char *)bytes;
    while (n > 0) {
        const ssize_t written = write(file, at, n);
        if (written < 0 && errno != EINTR) {
            return tlc_complain("nobody reads the answers any more");
        }
        if (written > 0) {
            at += written;
            n -= (size_t)written;
        }
    }
    return true;
}

/* A message being written: its 16 bytes of lengths, then its header. There is room for the longest
 * answer of this file. */
typedef struct tlc_text {
    char bytes[8192];
    size_t n;
} tlc_text;

static inline void tlc_begin(tlc_text *text)
{
    memcpy(text->bytes, "TLC1", 4);
    text->n = 16;
}

static inline void tlc_add(tlc_text *text, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    const size_t room = sizeof text->bytes - text->n;
    const int n = vsnprintf(text->bytes + text->n, room, format, arguments);
    va_end(arguments);
    text->n += n < 0 ? 0 : (size_t)n < room ? (size_t)n : room - 1;
}

/* Add a string; what is not ASCII becomes a question mark, what is too long is left out. */
static inline void tlc_add_string(tlc_text *text, const char *string)
{
    tlc_add(text, "\"");
    for (size_t i = 0; string[i] && i < 4 * TLC_REASON_BYTES; i++) {
        const unsigned char c = (unsigned char)string[i];
        if (c < 0x20 || c == '"' || c == '\\') {
            tlc_add(text, "\\u%04x", c);
        } else {
            tlc_add(text, "%c", c < 0x7f ? c : '?');
        }
    }
    tlc_add(text, "\"");
}

/* Add numbers. Those that are not finite go as null: JSON has no word for them. */
static inline void tlc_add_numbers(tlc_text *text, const double *numbers, size_t n)
{
    tlc_add(text, "[");
    for (size_t i = 0; i < n; i++) {
        tlc_add(text, isfinite(numbers[i]) ? "%s%.17g" : "%snull", i ? ", " : "", numbers[i]);
    }
    tlc_add(text, "]");
}

static inline bool tlc_send(const tlc_link *link, tlc_text *text, const void *payload,
                            size_t payload_bytes)
{
    unsigned char *lengths = (unsigned char *)text->bytes + 4;
    tlc_put_little_endian(lengths, text->n - 16, 4);
    tlc_put_little_endian(lengths + 4, payload_bytes, 8);
    return tlc_write_bytes(link->out, text->bytes, text->n)
           && tlc_write_bytes(link->out, payload, payload_bytes);
}

/* ------------------------------------------------------------------------ what the headers say */

/* Find an array of a message; false if it is missing or not inside its memory. */
static inline bool tlc_find_array(const tlc_link *link, const tlc_message *message,
                                  const char *wanted, tlc_array *array)
{
    const char *at = NULL;
    tlc_json key, part;
    char text[32];
    double shape[2];
    uint64_t offset;
    while (tlc_json_next(tlc_json_get(message->header, "parts"), &at, &key, &part)) {
        if (!tlc_json_string(tlc_json_get(part, "name"), text, sizeof text)
            || strcmp(text, wanted)) {
            continue;
        }
        if (!tlc_json_string(tlc_json_get(part, "dtype"), text, sizeof text) || strlen(text) != 2
            || !strchr("uf", text[0]) || !strchr(text[0] == 'u' ? "12" : "48", text[1])
            || tlc_json_numbers(tlc_json_get(part, "shape"), shape, 2) != 2
            || !tlc_json_count(tlc_json_get(part, "offset"), &offset)) {
            return false;
        }
        array->item_bytes = (size_t)(text[1] - '0');
        const bool is_shared = tlc_json_string(tlc_json_get(part, "where"), text, sizeof text)
                               && !strcmp(text, "shared_memory");
        const unsigned char *memory = is_shared ? (const unsigned char *)link->shared
                                                : message->payload;
        const uint64_t size = is_shared ? link->shared_bytes : message->payload_bytes;
        if (!memory || offset > size || !(shape[0] >= 1 && shape[1] >= 1)
            || shape[0] != floor(shape[0]) || shape[1] != floor(shape[1])
            || shape[0] * shape[1] * (double)array->item_bytes > (double)(size - offset)) {
            return false;
        }
        array->bytes = memory + offset;
        array->rows = (size_t)shape[0];
        array->columns = (size_t)shape[1];
        return true;
    }
    return false;
}

static inline bool tlc_read_pose(tlc_json value, tlc_pose *pose)
{
    return tlc_json_numbers(tlc_json_get(value, "position_m"), pose->position_m, 3) == 3
           && tlc_json_numbers(tlc_json_get(value, "quaternion_xyzw"), pose->quaternion_xyzw, 4)
                  == 4;
}

static inline bool tlc_read_camera(tlc_json value, tlc_camera *camera)
{
    uint64_t width, height;
    memset(camera, 0, sizeof *camera);
    if (!tlc_json_count(tlc_json_get(value, "width_px"), &width) || width > 1 << 20
        || !tlc_json_count(tlc_json_get(value, "height_px"), &height) || height > 1 << 20) {
        return false;
    }
    camera->width_px = (int)width;
    camera->height_px = (int)height;
    return tlc_json_number(tlc_json_get(value, "fx_px"), &camera->fx_px)
           && tlc_json_number(tlc_json_get(value, "fy_px"), &camera->fy_px)
           && tlc_json_number(tlc_json_get(value, "cx_px"), &camera->cx_px)
           && tlc_json_number(tlc_json_get(value, "cy_px"), &camera->cy_px)
           && tlc_json_numbers(tlc_json_get(value, "distortion"), camera->distortion,
                               TLC_N_DISTORTION) >= 0;
}

static inline bool tlc_is_size(const tlc_array *array, const tlc_camera *camera)
{
    return array->rows == (size_t)camera->height_px && array->columns == (size_t)camera->width_px;
}

static inline bool tlc_read_frame(const tlc_link *link, const tlc_message *message,
                                  tlc_frame *frame)
{
    const tlc_json prior = tlc_json_get(message->header, "prior");
    memset(frame, 0, sizeof *frame);
    if (!tlc_json_count(tlc_json_get(message->header, "number"), &frame->number)
        || !tlc_find_array(link, message, "image", &frame->image)
        || !tlc_find_array(link, message, "mask", &frame->mask)
        || !tlc_is_size(&frame->image, &link->setup.camera)
        || !tlc_is_size(&frame->mask, &link->setup.camera)) {
        return tlc_complain("a frame lacks its number, or image and mask of the camera's size");
    }
    if (!tlc_json_number(tlc_json_get(message->header, "time_s"), &frame->time_s)) {
        frame->time_s = (double)NAN;
    }
    frame->has_prior = prior.at && *prior.at == '{';
    if (frame->has_prior
        && (!tlc_read_pose(tlc_json_get(prior, "pose"), &frame->prior)
            || tlc_json_numbers(tlc_json_get(prior, "covariance"), frame->prior_covariance, 36)
                   != 36)) {
        return tlc_complain("a frame has a prior without a pose or without its covariance");
    }
    return true;
}

/* -------------------------------------------------------------------------------- conversation */

static inline void tlc_forget(tlc_link *link)
{
    if (link->shared) {
        munmap(link->shared, link->shared_bytes);
    }
    for (size_t i = 0; i < link->n_reference_messages; i++) {
        tlc_free_message(&link->reference_messages[i]);
    }
    free(link->reference_messages);
    free(link->references);
    link->shared = NULL;
    link->reference_messages = NULL;
    link->references = NULL;
    link->n_reference_messages = 0;
    link->is_ready = false;
}

static inline bool tlc_on_hello(tlc_link *link, tlc_message *message, const tlc_core *core)
{
    uint64_t protocol;
    if (!tlc_json_count(tlc_json_get(message->header, "protocol"), &protocol)
        || protocol != TLC_PROTOCOL) {
        return tlc_complain("tronlab speaks another protocol; this file knows protocol 1");
    }
    tlc_free_message(&link->hello); /* the settings stay in it */
    link->hello = *message;
    memset(message, 0, sizeof *message);
    link->setup.settings = tlc_json_get(link->hello.header, "settings");
    const tlc_json seed = tlc_json_get(link->hello.header, "seed");
    link->setup.seed = 0;
    if (seed.at && !tlc_json_count(seed, &link->setup.seed)) {
        return tlc_complain("the seed must be a whole number from 0 to 2^53");
    }
    tlc_text text;
    tlc_begin(&text);
    tlc_add(&text, "{\"type\": \"hello\", \"protocol\": %d, \"name\": ", TLC_PROTOCOL);
    tlc_add_string(&text, core->name);
    tlc_add(&text, ", \"version\": ");
    tlc_add_string(&text, core->version);
    tlc_add(&text, ", \"identity\": ");
    tlc_add_string(&text, core->identity ? core->identity : "");
    tlc_add(&text, ", \"sequential\": %s, \"references\": %s, \"shared_memory\": %s}",
            core->sequential ? "true" : "false", core->references ? "true" : "false",
            link->can_share_memory ? "true" : "false");
    return tlc_send(link, &text, NULL, 0);
}

static inline bool tlc_map_shared_memory(tlc_link *link, tlc_json shared)
{
    char path[512];
    uint64_t size;
    struct stat status;
    if (!shared.at || *shared.at == 'n') {
        return true;
    }
    if (!tlc_json_string(tlc_json_get(shared, "path"), path, sizeof path)
        || !tlc_json_count(tlc_json_get(shared, "size"), &size) || !size || size >= SIZE_MAX) {
        return tlc_complain("the shared memory has no path or no size");
    }
    const int file = open(path, O_RDONLY | O_CLOEXEC);
    if (file < 0 || fstat(file, &status) || (uint64_t)status.st_size < size) {
        if (file >= 0) {
            close(file);
        }
        return tlc_complain("the shared memory cannot be opened, or is smaller than it should be");
    }
    void *memory = mmap(NULL, (size_t)size, PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (memory == MAP_FAILED) {
        return tlc_complain("the shared memory cannot be mapped");
    }
    link->shared = memory;
    link->shared_bytes = (size_t)size;
    return true;
}

/* Read the reference views that follow setup. Room is made one by one: the count may lie. */
static inline bool tlc_read_references(tlc_link *link, uint64_t n)
{
    for (size_t i = 0; i < n; i++) {
        void *messages = realloc(link->reference_messages, (i + 1) * sizeof(tlc_message));
        if (messages) {
            link->reference_messages = (tlc_message *)messages;
        }
        void *views = realloc(link->references, (i + 1) * sizeof(tlc_reference));
        if (views) {
            link->references = (tlc_reference *)views;
        }
        if (!messages || !views) {
            return tlc_complain("no memory for the reference views");
        }
        tlc_message *message = &link->reference_messages[i];
        tlc_reference *view = &link->references[i];
        if (!tlc_read_message(link->in, message)) {
            return tlc_complain("the reference views ended too early");
        }
        link->n_reference_messages = i + 1;
        if (!tlc_read_pose(tlc_json_get(message->header, "pose"), &view->pose)
            || !tlc_find_array(link, message, "image", &view->image)
            || !tlc_find_array(link, message, "depth_m", &view->depth_m)
            || !tlc_find_array(link, message, "mask", &view->mask)
            || !tlc_is_size(&view->image, &link->setup.camera)
            || !tlc_is_size(&view->depth_m, &link->setup.camera)
            || !tlc_is_size(&view->mask, &link->setup.camera)) {
            return tlc_complain("a reference view lacks its pose, or arrays of the camera's size");
        }
    }
    return true;
}

static inline bool tlc_on_setup(tlc_link *link, const tlc_message *message, const tlc_core *core)
{
    uint64_t n_references = 0;
    char reason[TLC_REASON_BYTES] = "";
    tlc_forget(link);
    if (!link->hello.text) {
        return tlc_complain("setup came before hello");
    }
    if (!tlc_read_camera(tlc_json_get(message->header, "camera"), &link->setup.camera)
        || (core->references
            && !tlc_json_count(tlc_json_get(message->header, "n_references"), &n_references))) {
        return tlc_complain("setup lacks the camera or the number of reference views");
    }
    if (!tlc_map_shared_memory(link, tlc_json_get(message->header, "shared_memory"))
        || !tlc_read_references(link, n_references)) {
        return false;
    }
    link->setup.references = link->references;
    link->setup.n_references = link->n_reference_messages;
    link->is_ready = !core->setup || core->setup(core->state, &link->setup, reason);
    tlc_text text;
    tlc_begin(&text);
    if (link->is_ready) {
        tlc_add(&text, "{\"type\": \"ready\"}");
    } else {
        tlc_add(&text, "{\"type\": \"failed\", \"reason\": ");
        reason[TLC_REASON_BYTES - 1] = '\0';
        tlc_add_string(&text, reason);
        tlc_add(&text, "}");
    }
    return tlc_send(link, &text, NULL, 0);
}

static inline bool tlc_send_result(const tlc_link *link, uint64_t number, const tlc_result *result)
{
    tlc_text text;
    tlc_begin(&text);
    tlc_add(&text, "{\"type\": \"result\", \"number\": %llu, \"status\": \"%s\"",
            (unsigned long long)number, result->has_pose ? "ok" : "no_pose");
    if (result->has_pose) {
        tlc_add(&text, ", \"pose\": {\"parent\": \"trs\", \"child\": \"cam\", \"position_m\": ");
        tlc_add_numbers(&text, result->pose.position_m, 3);
        tlc_add(&text, ", \"quaternion_xyzw\": ");
        tlc_add_numbers(&text, result->pose.quaternion_xyzw, 4);
        tlc_add(&text, "}");
    }
    if (result->has_pose && result->has_covariance) {
        tlc_add(&text, ", \"covariance\": ");
        tlc_add_numbers(&text, result->covariance, 36);
    }
    tlc_add(&text, ", \"n_features\": %ld, \"n_matches\": %ld, \"n_inliers\": %ld",
            result->n_features, result->n_matches, result->n_inliers);
    tlc_add(&text, ", \"time_detect_s\": %.9g, \"time_match_s\": %.9g, \"time_pose_s\": %.9g",
            result->time_detect_s, result->time_match_s, result->time_pose_s);
    tlc_add(&text, ", \"reason\": ");
    tlc_add_string(&text, result->reason);
    if (!result->uv_inliers || result->n_inliers <= 0) {
        tlc_add(&text, "}");
        return tlc_send(link, &text, NULL, 0);
    }
    const size_t n_values = 2 * (size_t)result->n_inliers;
    tlc_add(&text,
            ", \"parts\": [{\"name\": \"uv_inliers\", \"dtype\": \"f8\", \"shape\": [%ld, 2], "
            "\"offset\": 0, \"where\": \"payload\"}]}",
            result->n_inliers);
    unsigned char *payload = (unsigned char *)malloc(8 * n_values);
    if (!payload) {
        return tlc_complain("no memory for the positions of the inliers");
    }
    for (size_t i = 0; i < n_values; i++) {
        uint64_t bits;
        memcpy(&bits, &result->uv_inliers[i], sizeof bits);
        tlc_put_little_endian(payload + 8 * i, bits, 8);
    }
    const bool is_sent = tlc_send(link, &text, payload, 8 * n_values);
    free(payload);
    return is_sent;
}

static inline bool tlc_on_frame(const tlc_link *link, const tlc_message *message,
                                const tlc_core *core)
{
    tlc_frame frame;
    tlc_result result;
    if (!link->is_ready) {
        return tlc_complain("a frame came before setup");
    }
    if (!tlc_read_frame(link, message, &frame)) {
        return false;
    }
    memset(&result, 0, sizeof result);
    core->locate(core->state, &frame, &result);
    result.reason[TLC_REASON_BYTES - 1] = '\0';
    return tlc_send_result(link, frame.number, &result);
}

/* Talk until the other side says bye or is gone; false if it said what it should not. */
static inline bool tlc_converse(tlc_link *link, const tlc_core *core)
{
    tlc_message message;
    char type[16] = "";
    bool is_fine = true;
    while (is_fine && strcmp(type, "bye")) {
        if (!tlc_read_message(link->in, &message)) {
            is_fine = message.is_end;
            break;
        }
        if (!tlc_json_string(tlc_json_get(message.header, "type"), type, sizeof type)) {
            is_fine = tlc_complain("a message has no type");
        } else if (!strcmp(type, "hello")) {
            is_fine = tlc_on_hello(link, &message, core);
        } else if (!strcmp(type, "setup")) {
            is_fine = tlc_on_setup(link, &message, core);
        } else if (!strcmp(type, "frame")) {
            is_fine = tlc_on_frame(link, &message, core);
        } else if (!strcmp(type, "reset")) {
            if (core->reset) {
                core->reset(core->state);
            }
        } else if (strcmp(type, "bye")) {
            is_fine = tlc_complain("a message is of a type that protocol 1 does not have");
        }
        tlc_free_message(&message);
    }
    tlc_forget(link);
    tlc_free_message(&link->hello);
    return is_fine;
}

/* --------------------------------------------------------------------------------- connections */

/* Open a socket that waits at "[HOST:]PORT", without a host at the loopback; -1 if it cannot. */
static inline int tlc_open_socket(const char *address)
{
    char host[256] = "127.0.0.1";
    const char *colon = strrchr(address, ':');
    const char *port = colon ? colon + 1 : address;
    if (colon) {
        const bool has_brackets = *address == '[' && colon > address + 1 && colon[-1] == ']';
        const char *begin = has_brackets ? address + 1 : address;
        snprintf(host, sizeof host, "%.*s", (int)(colon - begin - has_brackets), begin);
    }
    char *rest;
    if (*port < '0' || *port > '9' || strtoul(port, &rest, 10) > 65535 || *rest) {
        fprintf(stderr, "tronlab_core: --listen %s: write [HOST:]PORT, port 0 to 65535\n", address);
        return -1;
    }
    struct addrinfo hints, *found = NULL;
    memset(&hints, 0, sizeof hints);
    hints.ai_socktype = SOCK_STREAM;
    hints.ai_flags = AI_PASSIVE;
    const int problem = getaddrinfo(host, port, &hints, &found);
    if (problem) {
        fprintf(stderr, "tronlab_core: --listen %s: %s\n", address, gai_strerror(problem));
        return -1;
    }
    const int one = 1;
    const int server = socket(found->ai_family, found->ai_socktype, found->ai_protocol);
    const bool is_open = server >= 0
                         && !setsockopt(server, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one)
                         && !bind(server, found->ai_addr, found->ai_addrlen) && !listen(server, 8);
    freeaddrinfo(found);
    if (!is_open) {
        fprintf(stderr, "tronlab_core: --listen %s: %s\n", address, strerror(errno));
        if (server >= 0) {
            close(server);
        }
        return -1;
    }
    struct sockaddr_storage name;
    socklen_t n_name = sizeof name;
    char service[32] = "";
    if (!getsockname(server, (struct sockaddr *)&name, &n_name)
        && !getnameinfo((struct sockaddr *)&name, n_name, host, sizeof host, service,
                        sizeof service, NI_NUMERICHOST | NI_NUMERICSERV)) {
        fprintf(stderr, "listening on %s:%s\n", host, service);
    }
    return server;
}

/* Serve one connection after the other, until the program is ended. */
static inline int tlc_serve_socket(const tlc_core *core, const char *address)
{
    const int server = tlc_open_socket(address);
    if (server < 0) {
        return 2;
    }
    for (;;) {
        tlc_link link;
        memset(&link, 0, sizeof link);
        link.in = link.out = accept(server, NULL, NULL);
        if (link.in >= 0) {
            const int one = 1; /* answers are short, and waited for */
            setsockopt(link.in, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
            tlc_converse(&link, core);
            close(link.in);
        } else if (errno != EINTR && errno != ECONNABORTED) {
            perror("tronlab_core: accept");
            close(server);
            return 2;
        }
    }
}

/* Serve a core until tronlab has no more to ask. Gives the exit code of the program. */
static inline int tlc_serve(const tlc_core *core, int argc, char **argv)
{
    signal(SIGPIPE, SIG_IGN); /* a reader that is gone is found by write */
    for (int i = 1; i < argc; i++) {
        if (!strcmp(argv[i], "--listen")) {
            return i + 1 < argc ? tlc_serve_socket(core, argv[i + 1])
                                : (tlc_complain("--listen needs [HOST:]PORT"), 2);
        }
    }
    tlc_link link;
    memset(&link, 0, sizeof link);
    link.in = STDIN_FILENO;
    link.out = dup(STDOUT_FILENO); /* what the core prints shall not get between the messages */
    link.can_share_memory = true;
    if (link.out < 0 || dup2(STDERR_FILENO, STDOUT_FILENO) < 0) {
        perror("tronlab_core: standard output");
        return 2;
    }
    const bool is_fine = tlc_converse(&link, core);
    close(link.out);
    return is_fine ? 0 : 2;
}

#endif
