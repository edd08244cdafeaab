/* Events: new buffers of a stream, and the loss of a device as its error event. */
#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "modules.h"
#include "wire.h"

enum { ERROR_TEXT_SIZE = 64 };
static const char LOSS_TEXT[] = "the camera was lost";

/* Longer waits are cut to this, lest the clock overflow: 30 years. */
#define MAX_WAIT_MS 1000000000000u

/* What EventGetData hands out for EVENT_ERROR. */
struct error_data {
    GC_ERROR code;
    char text[ERROR_TEXT_SIZE];
};

void event_fire(struct event *event)
{
    event->n_fired++;
    pthread_cond_broadcast(event->changed);
}

void event_close(struct event *event)
{
    pthread_mutex_lock(event->lock);
    void *handle = event->handle;
    event->handle = NULL;
    event->is_closing = true;
    pthread_cond_broadcast(event->changed);
    pthread_mutex_unlock(event->lock);
    if (handle)
        handle_retire(handle);
    event->is_closing = false;
}

static size_t data_size(const struct event *event)
{
    return event->type == EVENT_NEW_BUFFER ? sizeof(EVENT_NEW_BUFFER_DATA)
                                           : sizeof(struct error_data);
}

static size_t n_waiting(const struct event *event)
{
    return event->type == EVENT_NEW_BUFFER ? event->stream->output.size
                                           : event->device->is_loss_pending;
}

/* The event of a source, NULL with the error set if it has none of this type. */
static struct event *event_of(void *source, enum module_kind kind, int32_t type)
{
    if (kind == MODULE_STREAM && type == EVENT_NEW_BUFFER)
        return &((struct stream *)source)->new_buffer;
    if (kind == MODULE_DEVICE && type == EVENT_ERROR)
        return &((struct device *)source)->error;
    fail(GC_ERR_NOT_IMPLEMENTED, "this module has no event of type %d", type);
    return NULL;
}

GC_API GCRegisterEvent(EVENTSRC_HANDLE source_handle, int32_t type, EVENT_HANDLE *result)
{
    enum module_kind kind;
    GC_ERROR error = GC_ERR_SUCCESS;
    tree_lock();
    void *source = handle_pin_any(source_handle, &kind);
    struct event *event = source ? event_of(source, kind, type) : NULL;
    if (!event)
        error = last_error_code();
    else if (event->handle)
        error = fail(GC_ERR_RESOURCE_IN_USE, "the event is registered already");
    else if (!(event->handle = handle_new(MODULE_EVENT, event)))
        error = last_error_code();
    else
        *result = event->handle;
    if (source)
        handle_unpin(source_handle);
    tree_unlock();
    return error;
}

GC_API GCUnregisterEvent(EVENTSRC_HANDLE source_handle, int32_t type)
{
    enum module_kind kind;
    GC_ERROR error = GC_ERR_SUCCESS;
    tree_lock();
    void *source = handle_pin_any(source_handle, &kind);
    struct event *event = source ? event_of(source, kind, type) : NULL;
    if (source)
        handle_unpin(source_handle);
    if (!event)
        error = last_error_code();
    else if (!event->handle)
        error = fail(GC_ERR_INVALID_PARAMETER, "the event is not registered");
    else
        event_close(event);
    tree_unlock();
    return error;
}

static void take_data(struct event *event, void *data)
{
    if (event->type == EVENT_NEW_BUFFER) {
        struct buffer *buffer = queue_pop(&event->stream->output);
        EVENT_NEW_BUFFER_DATA new_buffer = {buffer->handle, buffer->user_pointer};
        memcpy(data, &new_buffer, sizeof new_buffer);
        return;
    }
    struct error_data loss = {.code = GC_ERR_IO};
    snprintf(loss.text, sizeof loss.text, "%s", LOSS_TEXT);
    memcpy(data, &loss, sizeof loss);
    event->device->is_loss_pending = false;
}

/* Why there is no use in waiting on; success if there are data. */
static GC_ERROR wait_for_data(struct event *event, uint64_t timeout_ms)
{
    uint64_t wait_ms = timeout_ms < MAX_WAIT_MS ? timeout_ms : MAX_WAIT_MS;
    struct timespec end = timespec_from_us(clock_us() + 1000 * wait_ms);
    int waited = 0;
    while (!n_waiting(event) && waited != ETIMEDOUT && !event->is_killed && !event->is_closing) {
        if (event->stream && gvcp_is_lost(event->device->channel))
            return fail(GC_ERR_IO, LOSS_TEXT);
        waited = pthread_cond_timedwait(event->changed, event->lock, &end);
    }
    if (event->is_killed || event->is_closing) {
        event->is_killed = false;
        return fail(GC_ERR_ABORT, "the wait was ended");
    }
    return n_waiting(event) ? GC_ERR_SUCCESS
                            : fail(GC_ERR_TIMEOUT, "no event within %llu ms",
                                   (unsigned long long)timeout_ms);
}

GC_API EventGetData(EVENT_HANDLE handle, void *data, size_t *size, uint64_t timeout_ms)
{
    struct event *event = handle_pin(handle, MODULE_EVENT);
    if (!event)
        return last_error_code();
    GC_ERROR error;
    if (!data || !size || *size < data_size(event)) {
        error = fail(GC_ERR_BUFFER_TOO_SMALL, "the event needs %zu bytes", data_size(event));
    } else {
        *size = data_size(event);
        pthread_mutex_lock(event->lock);
        error = wait_for_data(event, timeout_ms);
        if (!error)
            take_data(event, data);
        pthread_mutex_unlock(event->lock);
    }
    handle_unpin(handle);
    return error;
}

static GC_ERROR new_buffer_data_info(const void *data, int32_t command, struct answer answer)
{
    EVENT_NEW_BUFFER_DATA new_buffer;
    memcpy(&new_buffer, data, sizeof new_buffer);
    switch (command) {
    case EVENT_DATA_ID:
        return answer_pointer(answer, new_buffer.BufferHandle);
    case EVENT_DATA_VALUE:
        return answer_pointer(answer, new_buffer.pUserPointer);
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "event information %d is not known here", command);
    }
}

static GC_ERROR error_data_info(const void *data, int32_t command, struct answer answer)
{
    struct error_data loss;
    memcpy(&loss, data, sizeof loss);
    loss.text[sizeof loss.text - 1] = '\0';
    switch (command) {
    case EVENT_DATA_ID:
        return answer_int32(answer, loss.code);
    case EVENT_DATA_VALUE:
        return answer_string(answer, loss.text);
    case EVENT_DATA_NUMID:
        return answer_uint64(answer, (uint64_t)(int64_t)loss.code);
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "event information %d is not known here", command);
    }
}

GC_API EventGetDataInfo(EVENT_HANDLE handle, const void *data, size_t size, int32_t command,
                        INFO_DATATYPE *type, void *buffer, size_t *result_size)
{
    struct event *event = handle_pin(handle, MODULE_EVENT);
    if (!event)
        return last_error_code();
    struct answer answer = {type, buffer, result_size};
    GC_ERROR error;
    if (!data || size < data_size(event))
        error = fail(GC_ERR_INVALID_PARAMETER, "event data have %zu bytes", data_size(event));
    else if (event->type == EVENT_NEW_BUFFER)
        error = new_buffer_data_info(data, command, answer);
    else
        error = error_data_info(data, command, answer);
    handle_unpin(handle);
    return error;
}

static GC_ERROR event_info(const struct event *event, int32_t command, struct answer answer)
{
    switch (command) {
    case EVENT_EVENT_TYPE:
        return answer_int32(answer, event->type);
    case EVENT_NUM_IN_QUEUE:
        return answer_size(answer, n_waiting(event));
    case EVENT_NUM_FIRED:
        return answer_uint64(answer, event->n_fired);
    case EVENT_SIZE_MAX:
    case EVENT_INFO_DATA_SIZE_MAX:
        return answer_size(answer, data_size(event));
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "event information %d is not known here", command);
    }
}

GC_API EventGetInfo(EVENT_HANDLE handle, int32_t command, INFO_DATATYPE *type, void *buffer,
                    size_t *size)
{
    struct event *event = handle_pin(handle, MODULE_EVENT);
    if (!event)
        return last_error_code();
    pthread_mutex_lock(event->lock);
    GC_ERROR error = event_info(event, command, (struct answer){type, buffer, size});
    pthread_mutex_unlock(event->lock);
    handle_unpin(handle);
    return error;
}

GC_API EventFlush(EVENT_HANDLE handle)
{
    struct event *event = handle_pin(handle, MODULE_EVENT);
    if (!event)
        return last_error_code();
    pthread_mutex_lock(event->lock);
    while (event->stream && queue_pop(&event->stream->output))
        continue;
    if (!event->stream)
        event->device->is_loss_pending = false;
    pthread_mutex_unlock(event->lock);
    handle_unpin(handle);
    return GC_ERR_SUCCESS;
}

GC_API EventKill(EVENT_HANDLE handle)
{
    struct event *event = handle_pin(handle, MODULE_EVENT);
    if (!event)
        return last_error_code();
    pthread_mutex_lock(event->lock);
    event->is_killed = true;
    pthread_cond_broadcast(event->changed);
    pthread_mutex_unlock(event->lock);
    handle_unpin(handle);
    return GC_ERR_SUCCESS;
}
