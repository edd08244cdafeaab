/* The stream of a device: from the input queue through the receiver to the output queue. */
#include <stdlib.h>
#include <string.h>

#include "modules.h"

/* Called by the receiver's thread: the next buffer to fill. */
static struct frame *take(void *context)
{
    struct stream *stream = context;
    struct buffer *buffer = NULL;
    pthread_mutex_lock(&stream->lock);
    if (stream->n_frames_left > 0)
        buffer = queue_pop(&stream->input);
    if (buffer) {
        buffer->state = BUFFER_FILLING;
        if (stream->n_frames_left != GENTL_INFINITE)
            stream->n_frames_left--;
    }
    pthread_mutex_unlock(&stream->lock);
    return buffer ? &buffer->frame : NULL;
}

static void deliver(void *context, struct frame *frame)
{
    struct stream *stream = context;
    struct buffer *buffer = (struct buffer *)frame;
    pthread_mutex_lock(&stream->lock);
    buffer->has_new_data = true;
    queue_push(&stream->output, buffer, BUFFER_OUTPUT);
    stream->n_delivered++;
    event_fire(&stream->new_buffer);
    pthread_mutex_unlock(&stream->lock);
}

static void give_back(void *context, struct frame *frame)
{
    struct stream *stream = context;
    pthread_mutex_lock(&stream->lock);
    queue_push_front(&stream->input, (struct buffer *)frame, BUFFER_INPUT);
    pthread_mutex_unlock(&stream->lock);
}

static void request(void *context, uint16_t block_id, uint32_t first, uint32_t last)
{
    struct stream *stream = context;
    gvcp_request_resend(stream->device->channel, block_id, first, last);
}

static void set_stream(struct device *device, struct stream *stream)
{
    pthread_mutex_lock(&device->lock);
    device->stream = stream;
    pthread_mutex_unlock(&device->lock);
}

GC_ERROR stream_open(struct device *device, void **handle)
{
    struct stream *stream = calloc(1, sizeof *stream);
    if (!stream)
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory for a stream");
    stream->device = device;
    stream->handle = handle_new(MODULE_STREAM, stream);
    if (!stream->handle) {
        free(stream);
        return GC_ERR_OUT_OF_MEMORY;
    }
    pthread_mutex_init(&stream->lock, NULL);
    condition_init(&stream->changed);
    stream->new_buffer = (struct event){.type = EVENT_NEW_BUFFER,
                                        .lock = &stream->lock,
                                        .changed = &stream->changed,
                                        .device = device,
                                        .stream = stream};
    set_stream(device, stream);
    *handle = stream->handle;
    return GC_ERR_SUCCESS;
}

static void add_counts(struct assembly_counts *sum, const struct assembly_counts *counts)
{
    sum->started += counts->started;
    sum->incomplete += counts->incomplete;
    sum->underruns += counts->underruns;
    sum->skipped += counts->skipped;
    sum->packets_requested += counts->packets_requested;
    sum->packets_refused += counts->packets_refused;
    sum->packets_stale += counts->packets_stale;
    sum->packets_malformed += counts->packets_malformed;
}

struct assembly_counts stream_counts(struct stream *stream)
{
    pthread_mutex_lock(&stream->lock);
    struct assembly_counts counts = stream->past;
    if (stream->receiver) {
        struct assembly_counts present = receiver_counts(stream->receiver);
        add_counts(&counts, &present);
    }
    pthread_mutex_unlock(&stream->lock);
    return counts;
}

static GC_ERROR start(struct stream *stream, uint64_t n_frames)
{
    if (stream->receiver)
        return fail(GC_ERR_RESOURCE_IN_USE, "the acquisition runs already");
    struct assembly_host host = {stream, take, deliver, give_back, request};
    struct receiver *receiver;
    pthread_mutex_lock(&stream->lock);
    stream->n_frames_left = n_frames;
    pthread_mutex_unlock(&stream->lock);
    struct device *device = stream->device;
    GC_ERROR error = receiver_start(device->channel, &device->camera.address, &host, &receiver);
    if (error)
        return error;
    pthread_mutex_lock(&stream->lock);
    stream->receiver = receiver;
    pthread_mutex_unlock(&stream->lock);
    return GC_ERR_SUCCESS;
}

static void stop(struct stream *stream)
{
    pthread_mutex_lock(&stream->lock);
    struct receiver *receiver = stream->receiver;
    stream->receiver = NULL;
    pthread_mutex_unlock(&stream->lock);
    struct assembly_counts counts = receiver_stop(receiver);
    pthread_mutex_lock(&stream->lock);
    add_counts(&stream->past, &counts);
    pthread_mutex_unlock(&stream->lock);
}

void stream_close(struct stream *stream)
{
    if (stream->receiver)
        stop(stream);
    event_close(&stream->new_buffer);
    set_stream(stream->device, NULL);
    handle_retire(stream->handle);
    for (struct buffer *buffer = stream->announced, *next; buffer; buffer = next) {
        next = buffer->next_announced;
        handle_retire(buffer->handle);
        buffer_free(buffer);
    }
    pthread_cond_destroy(&stream->changed);
    pthread_mutex_destroy(&stream->lock);
    free(stream);
}

static struct stream *look_up(void *handle)
{
    struct stream *stream = handle_pin(handle, MODULE_STREAM);
    if (stream)
        handle_unpin(handle);
    return stream;
}

GC_API DSClose(DS_HANDLE handle)
{
    tree_lock();
    struct stream *stream = look_up(handle);
    if (stream)
        stream_close(stream);
    tree_unlock();
    return stream ? GC_ERR_SUCCESS : last_error_code();
}

GC_API DSStartAcquisition(DS_HANDLE handle, int32_t flags, uint64_t n_frames)
{
    (void)flags; /* the standard knows only the default */
    tree_lock();
    struct stream *stream = look_up(handle);
    GC_ERROR error = stream ? start(stream, n_frames) : last_error_code();
    tree_unlock();
    return error;
}

GC_API DSStopAcquisition(DS_HANDLE handle, int32_t flags)
{
    (void)flags; /* frames under way are given up in any case: the camera was stopped before */
    GC_ERROR error = GC_ERR_SUCCESS;
    tree_lock();
    struct stream *stream = look_up(handle);
    if (!stream)
        error = last_error_code();
    else if (!stream->receiver)
        error = fail(GC_ERR_RESOURCE_IN_USE, "no acquisition runs");
    else
        stop(stream);
    tree_unlock();
    return error;
}

GC_API DSGetParentDev(DS_HANDLE handle, DEV_HANDLE *result)
{
    struct stream *stream = handle_pin(handle, MODULE_STREAM);
    if (!stream)
        return last_error_code();
    *result = stream->device->handle;
    handle_unpin(handle);
    return GC_ERR_SUCCESS;
}

static GC_ERROR queue_info(struct stream *stream, int32_t command, struct answer answer)
{
    pthread_mutex_lock(&stream->lock);
    uint64_t n_delivered = stream->n_delivered;
    size_t n_announced = stream->n_announced, n_input = stream->input.size;
    size_t n_output = stream->output.size;
    bool is_grabbing = stream->receiver != NULL;
    pthread_mutex_unlock(&stream->lock);
    switch (command) {
    case STREAM_INFO_NUM_DELIVERED:
        return answer_uint64(answer, n_delivered);
    case STREAM_INFO_NUM_ANNOUNCED:
        return answer_size(answer, n_announced);
    case STREAM_INFO_NUM_QUEUED:
        return answer_size(answer, n_input);
    case STREAM_INFO_NUM_AWAIT_DELIVERY:
        return answer_size(answer, n_output);
    case STREAM_INFO_IS_GRABBING:
        return answer_bool(answer, is_grabbing);
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "stream information %d is not known here", command);
    }
}

static GC_ERROR stream_info(struct stream *stream, int32_t command, struct answer answer)
{
    switch (command) {
    case STREAM_INFO_ID:
        return answer_string(answer, STREAM_ID);
    case STREAM_INFO_TLTYPE:
        return answer_string(answer, TRANSPORT);
    case STREAM_INFO_NUM_UNDERRUN:
        return answer_uint64(answer, stream_counts(stream).underruns);
    case STREAM_INFO_NUM_STARTED:
        return answer_uint64(answer, stream_counts(stream).started);
    case STREAM_INFO_DEFINES_PAYLOADSIZE:
        return answer_bool(answer, false); /* the camera's own PayloadSize does */
    case STREAM_INFO_NUM_CHUNKS_MAX:
        return answer_size(answer, 0);
    case STREAM_INFO_BUF_ANNOUNCE_MIN:
    case STREAM_INFO_BUF_ALIGNMENT:
        return answer_size(answer, 1);
    default:
        return queue_info(stream, command, answer);
    }
}

GC_API DSGetInfo(DS_HANDLE handle, int32_t command, INFO_DATATYPE *type, void *buffer,
                 size_t *size)
{
    struct stream *stream = handle_pin(handle, MODULE_STREAM);
    if (!stream)
        return last_error_code();
    GC_ERROR error = stream_info(stream, command, (struct answer){type, buffer, size});
    handle_unpin(handle);
    return error;
}
