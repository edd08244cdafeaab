/* The consumer's buffers, and the queues they wait in. */
#include <stdlib.h>

#include "modules.h"

void queue_push(struct queue *queue, struct buffer *buffer, enum buffer_state state)
{
    buffer->state = state;
    buffer->next_queued = NULL;
    if (queue->last)
        queue->last->next_queued = buffer;
    else
        queue->first = buffer;
    queue->last = buffer;
    queue->size++;
}

void queue_push_front(struct queue *queue, struct buffer *buffer, enum buffer_state state)
{
    buffer->state = state;
    buffer->next_queued = queue->first;
    queue->first = buffer;
    if (!queue->last)
        queue->last = buffer;
    queue->size++;
}

struct buffer *queue_pop(struct queue *queue)
{
    struct buffer *buffer = queue->first;
    if (!buffer)
        return NULL;
    queue->first = buffer->next_queued;
    if (!queue->first)
        queue->last = NULL;
    queue->size--;
    buffer->state = BUFFER_IDLE;
    return buffer;
}

void buffer_free(struct buffer *buffer)
{
    if (buffer->is_owned)
        free(buffer->frame.base);
    free(buffer);
}

static GC_ERROR announce(struct stream *stream, void *base, size_t size, void *user_pointer,
                         bool is_owned, BUFFER_HANDLE *result)
{
    struct buffer *buffer = calloc(1, sizeof *buffer);
    if (buffer)
        buffer->handle = handle_new(MODULE_BUFFER, buffer);
    if (!buffer || !buffer->handle) {
        free(buffer);
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory for a buffer");
    }
    buffer->frame = (struct frame){.base = base, .size = size};
    buffer->user_pointer = user_pointer;
    buffer->stream = stream;
    buffer->is_owned = is_owned;
    pthread_mutex_lock(&stream->lock);
    struct buffer **link = &stream->announced;
    while (*link)
        link = &(*link)->next_announced;
    *link = buffer;
    stream->n_announced++;
    pthread_mutex_unlock(&stream->lock);
    *result = buffer->handle;
    return GC_ERR_SUCCESS;
}

GC_API DSAnnounceBuffer(DS_HANDLE handle, void *base, size_t size, void *user_pointer,
                        BUFFER_HANDLE *result)
{
    if (!base || !size || !result)
        return fail(GC_ERR_INVALID_PARAMETER, "a buffer of %zu bytes at %p", size, base);
    struct stream *stream = handle_pin(handle, MODULE_STREAM);
    if (!stream)
        return last_error_code();
    GC_ERROR error = announce(stream, base, size, user_pointer, false, result);
    handle_unpin(handle);
    return error;
}

GC_API DSAllocAndAnnounceBuffer(DS_HANDLE handle, size_t size, void *user_pointer,
                                BUFFER_HANDLE *result)
{
    if (!size || !result)
        return fail(GC_ERR_INVALID_PARAMETER, "a buffer of %zu bytes", size);
    struct stream *stream = handle_pin(handle, MODULE_STREAM);
    if (!stream)
        return last_error_code();
    void *base = malloc(size);
    GC_ERROR error = base ? announce(stream, base, size, user_pointer, true, result)
                          : fail(GC_ERR_OUT_OF_MEMORY, "no memory for %zu bytes", size);
    if (error)
        free(base);
    handle_unpin(handle);
    return error;
}

bool pin_pair(void *stream_handle, void *buffer_handle, struct pair *pair)
{
    pair->stream = handle_pin(stream_handle, MODULE_STREAM);
    if (!pair->stream)
        return false;
    pair->buffer = handle_pin(buffer_handle, MODULE_BUFFER);
    if (pair->buffer && pair->buffer->stream == pair->stream) {
        pthread_mutex_lock(&pair->stream->lock);
        return true;
    }
    if (pair->buffer) {
        handle_unpin(buffer_handle);
        fail(GC_ERR_INVALID_HANDLE, "the buffer is another stream's");
    }
    handle_unpin(stream_handle);
    return false;
}

void unpin_pair(void *stream_handle, void *buffer_handle, const struct pair *pair)
{
    pthread_mutex_unlock(&pair->stream->lock);
    handle_unpin(buffer_handle);
    handle_unpin(stream_handle);
}

GC_API DSQueueBuffer(DS_HANDLE stream_handle, BUFFER_HANDLE buffer_handle)
{
    GC_ERROR error = GC_ERR_SUCCESS;
    struct pair pair;
    if (!pin_pair(stream_handle, buffer_handle, &pair))
        return last_error_code();
    if (pair.buffer->state == BUFFER_IDLE) {
        pair.buffer->has_new_data = false;
        queue_push(&pair.stream->input, pair.buffer, BUFFER_INPUT);
    } else {
        error = fail(GC_ERR_RESOURCE_IN_USE, "the buffer is queued already");
    }
    unpin_pair(stream_handle, buffer_handle, &pair);
    return error;
}

static void forget(struct stream *stream, struct buffer *buffer)
{
    struct buffer **link = &stream->announced;
    while (*link != buffer)
        link = &(*link)->next_announced;
    *link = buffer->next_announced;
    stream->n_announced--;
}

static GC_ERROR revoke(void *stream_handle, void *buffer_handle, void **base, void **user_pointer)
{
    struct pair pair;
    if (!pin_pair(stream_handle, buffer_handle, &pair))
        return last_error_code();
    bool is_idle = pair.buffer->state == BUFFER_IDLE;
    if (is_idle)
        forget(pair.stream, pair.buffer);
    unpin_pair(stream_handle, buffer_handle, &pair);
    if (!is_idle)
        return fail(GC_ERR_BUSY, "the buffer is queued; flush the queues first");
    handle_retire(buffer_handle);
    if (base)
        *base = pair.buffer->is_owned ? NULL : pair.buffer->frame.base;
    if (user_pointer)
        *user_pointer = pair.buffer->user_pointer;
    buffer_free(pair.buffer);
    return GC_ERR_SUCCESS;
}

GC_API DSRevokeBuffer(DS_HANDLE stream_handle, BUFFER_HANDLE buffer_handle, void **base,
                      void **user_pointer)
{
    tree_lock(); /* so that no second revocation finds the same handle */
    GC_ERROR error = revoke(stream_handle, buffer_handle, base, user_pointer);
    tree_unlock();
    return error;
}

static void move_all(struct queue *from, struct queue *to, enum buffer_state state)
{
    struct buffer *buffer;
    while ((buffer = queue_pop(from)))
        queue_push(to, buffer, state);
}

static void discard_all(struct queue *queue)
{
    while (queue_pop(queue))
        continue;
}

static void queue_idle(struct stream *stream)
{
    for (struct buffer *buffer = stream->announced; buffer; buffer = buffer->next_announced)
        if (buffer->state == BUFFER_IDLE)
            queue_push(&stream->input, buffer, BUFFER_INPUT);
}

static GC_ERROR flush(struct stream *stream, int32_t operation)
{
    switch (operation) {
    case ACQ_QUEUE_INPUT_TO_OUTPUT:
        move_all(&stream->input, &stream->output, BUFFER_OUTPUT);
        pthread_cond_broadcast(&stream->changed);
        return GC_ERR_SUCCESS;
    case ACQ_QUEUE_OUTPUT_DISCARD:
        discard_all(&stream->output);
        return GC_ERR_SUCCESS;
    case ACQ_QUEUE_ALL_TO_INPUT:
        move_all(&stream->output, &stream->input, BUFFER_INPUT);
        queue_idle(stream);
        return GC_ERR_SUCCESS;
    case ACQ_QUEUE_UNQUEUED_TO_INPUT:
        queue_idle(stream);
        return GC_ERR_SUCCESS;
    case ACQ_QUEUE_ALL_DISCARD:
        discard_all(&stream->input);
        discard_all(&stream->output);
        return GC_ERR_SUCCESS;
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "queue operation %d is not known here", operation);
    }
}

GC_API DSFlushQueue(DS_HANDLE handle, int32_t operation)
{
    struct stream *stream = handle_pin(handle, MODULE_STREAM);
    if (!stream)
        return last_error_code();
    pthread_mutex_lock(&stream->lock);
    GC_ERROR error = flush(stream, operation);
    pthread_mutex_unlock(&stream->lock);
    handle_unpin(handle);
    return error;
}

GC_API DSGetBufferID(DS_HANDLE handle, uint32_t index, BUFFER_HANDLE *result)
{
    struct stream *stream = handle_pin(handle, MODULE_STREAM);
    if (!stream)
        return last_error_code();
    pthread_mutex_lock(&stream->lock);
    struct buffer *buffer = stream->announced;
    for (uint32_t i = 0; buffer && i < index; i++)
        buffer = buffer->next_announced;
    if (buffer)
        *result = buffer->handle;
    pthread_mutex_unlock(&stream->lock);
    handle_unpin(handle);
    return buffer ? GC_ERR_SUCCESS : fail(GC_ERR_INVALID_INDEX, "there is no buffer %u", index);
}
