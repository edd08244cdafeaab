/* The modules behind the handles, and who may touch what.
 *
 * Opening, closing, listing, starting and stopping are done one at a time, under the tree's lock.
 * All other calls pin what they use, so that closing waits for them, and never take the tree's
 * lock. A device's lock may be held when a stream's is taken, not the other way round. */
#ifndef TRONLAB_MODULES_H
#define TRONLAB_MODULES_H

#include <pthread.h>

#include "answer.h"
#include "discovery.h"
#include "gvcp.h"
#include "handles.h"
#include "receiver.h"
#include "threads.h"

#define PRODUCER_NAME "tronlab_gev"
#define PRODUCER_VENDOR "tronlab"
#define PRODUCER_VERSION "0.1.0"
#define TRANSPORT "GEV"
#define STREAM_ID "Stream0"

struct system {
    void *handle;
    struct interface *interfaces[MAX_ROUTES];
    size_t n_interfaces;
};

struct interface {
    struct system *system;
    void *handle; /* NULL while closed */
    struct route route;
    struct camera cameras[MAX_CAMERAS];
    size_t n_cameras;
    struct device *devices; /* the open ones */
};

/* Something a consumer waits for: buffers of a stream, or the loss of a device. Guarded by its
 * source's lock. */
struct event {
    void *handle; /* NULL while not registered */
    int32_t type;
    pthread_mutex_t *lock;
    pthread_cond_t *changed;
    struct device *device;
    struct stream *stream; /* NULL for a device's event */
    bool is_killed;
    bool is_closing;
    uint64_t n_fired;
};

struct device {
    struct interface *interface;
    struct device *next;
    void *handle;
    void *port_handle;
    struct camera camera;
    int32_t access;
    bool has_control;
    struct gvcp *channel;
    uint64_t tick_frequency;
    char urls[2][GVCP_URL_SIZE + 1];
    uint32_t n_urls;

    pthread_mutex_t lock; /* guards what follows */
    pthread_cond_t changed;
    struct stream *stream; /* NULL while closed */
    struct event error;
    bool is_loss_pending; /* not yet fetched by the error event */
};

enum buffer_state { BUFFER_IDLE, BUFFER_INPUT, BUFFER_FILLING, BUFFER_OUTPUT };

struct buffer {
    struct frame frame; /* first, so that a frame's address is its buffer's */
    void *handle;
    void *user_pointer;
    struct stream *stream;
    bool is_owned; /* the memory was allocated here */
    bool has_new_data;
    enum buffer_state state;
    struct buffer *next_announced;
    struct buffer *next_queued;
};

struct queue {
    struct buffer *first, *last;
    size_t size;
};

struct stream {
    struct device *device;
    void *handle;
    struct receiver *receiver; /* NULL while not acquiring; changes under both locks */
    uint64_t n_frames_left;    /* of this acquisition */

    pthread_mutex_t lock; /* guards what follows, and the buffers */
    pthread_cond_t changed;
    struct buffer *announced;
    size_t n_announced;
    struct queue input, output;
    struct event new_buffer;
    uint64_t n_delivered;
    struct assembly_counts past; /* of acquisitions that are over */
};

/* A stream and one of its buffers, both pinned and the stream locked. */
struct pair {
    struct stream *stream;
    struct buffer *buffer;
};

/* library.c */
bool library_is_open(void);
void tree_lock(void);
void tree_unlock(void);

/* system.c: under the tree's lock, as all that opens and closes */
void system_close(void);
void interface_forget_device(struct interface *interface, struct device *device);

/* device.c */
GC_ERROR device_open(struct interface *interface, const struct camera *camera, int32_t access,
                     struct device **device);
void device_close(struct device *device);
GC_ERROR device_info(struct device *device, int32_t command, struct answer answer);
GC_ERROR camera_info(const struct camera *camera, int32_t command, struct answer answer);

/* stream.c */
GC_ERROR stream_open(struct device *device, void **handle);
void stream_close(struct stream *stream);
struct assembly_counts stream_counts(struct stream *stream);

/* buffers.c: the queues under the stream's lock */
void queue_push(struct queue *queue, struct buffer *buffer, enum buffer_state state);
struct buffer *queue_pop(struct queue *queue);
void queue_push_front(struct queue *queue, struct buffer *buffer, enum buffer_state state);
void buffer_free(struct buffer *buffer);
bool pin_pair(void *stream_handle, void *buffer_handle, struct pair *pair);
void unpin_pair(void *stream_handle, void *buffer_handle, const struct pair *pair);

/* events.c: under the source's lock, except event_close, which takes it */
void event_fire(struct event *event);
void event_close(struct event *event);

#endif
