/* A camera that is open: its control channel, its one stream, its loss. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "modules.h"

/* Overrides the negotiation of the packet size. */
#define PACKET_SIZE_VARIABLE "TRONLAB_GEV_PACKET_SIZE"
enum { MIN_PACKET_SIZE = 576, MAX_PACKET_SIZE = 16384 };

/* Called by the heartbeat: wake all who wait for this camera. */
static void on_lost(void *context)
{
    struct device *device = context;
    pthread_mutex_lock(&device->lock);
    device->is_loss_pending = true;
    event_fire(&device->error);
    struct stream *stream = device->stream;
    if (stream) {
        pthread_mutex_lock(&stream->lock);
        pthread_cond_broadcast(&stream->changed);
        pthread_mutex_unlock(&stream->lock);
    }
    pthread_mutex_unlock(&device->lock);
}

static GC_ERROR read_urls(struct device *device)
{
    static const uint32_t addresses[] = {GVCP_FIRST_URL, GVCP_SECOND_URL};
    for (size_t i = 0; i < 2; i++) {
        char *url = device->urls[device->n_urls];
        GC_ERROR error =
            gvcp_read(device->channel, addresses[i], (uint8_t *)url, GVCP_URL_SIZE);
        if (error && i == 0)
            return error;
        if (!error && url[0])
            device->n_urls++;
    }
    return GC_ERR_SUCCESS;
}

static GC_ERROR read_tick_frequency(struct device *device)
{
    uint32_t high, low;
    GC_ERROR error = gvcp_read_register(device->channel, GVCP_TICK_FREQUENCY_HIGH, &high);
    if (!error)
        error = gvcp_read_register(device->channel, GVCP_TICK_FREQUENCY_LOW, &low);
    if (!error)
        device->tick_frequency = (uint64_t)high << 32 | low;
    return error;
}

static GC_ERROR fixed_packet_size(uint32_t *packet_size)
{
    const char *text = getenv(PACKET_SIZE_VARIABLE);
    *packet_size = 0;
    if (!text || !*text)
        return GC_ERR_SUCCESS;
    char *end;
    unsigned long value = strtoul(text, &end, 10);
    if (*end || value < MIN_PACKET_SIZE || value > MAX_PACKET_SIZE)
        return fail(GC_ERR_INVALID_PARAMETER,
                    PACKET_SIZE_VARIABLE ": '%s' is no packet size; allowed are %d to %d bytes",
                    text, MIN_PACKET_SIZE, MAX_PACKET_SIZE);
    *packet_size = (uint32_t)value;
    return GC_ERR_SUCCESS;
}

/* Take the control privilege, which a camera grants to one application at a time. */
static GC_ERROR take_control(struct device *device)
{
    uint32_t privilege = device->access == DEVICE_ACCESS_EXCLUSIVE ? GVCP_EXCLUSIVE : GVCP_CONTROL;
    uint32_t packet_size;
    GC_ERROR error = fixed_packet_size(&packet_size);
    if (!error)
        error = gvcp_write_register(device->channel, GVCP_CONTROL_PRIVILEGE, privilege);
    if (error == GC_ERR_ACCESS_DENIED)
        return fail(error, "camera '%s' is controlled by another application",
                    device->camera.id);
    device->has_control = !error;
    if (!error)
        error = gvcp_start_heartbeat(device->channel, on_lost, device);
    if (!error)
        error = negotiate_packet_size(device->channel, packet_size);
    return error;
}

static GC_ERROR connect_camera(struct device *device)
{
    GC_ERROR error =
        gvcp_open(&device->camera.address, device->interface->route.from, &device->channel);
    if (!error && device->access >= DEVICE_ACCESS_CONTROL)
        error = take_control(device);
    if (!error)
        error = read_urls(device);
    if (!error)
        error = read_tick_frequency(device);
    return error;
}

static bool make_handles(struct device *device)
{
    device->handle = handle_new(MODULE_DEVICE, device);
    device->port_handle = handle_new(MODULE_REMOTE_DEVICE, device);
    return device->handle && device->port_handle;
}

static void free_device(struct device *device)
{
    if (device->handle)
        handle_retire(device->handle);
    if (device->port_handle)
        handle_retire(device->port_handle);
    if (device->channel) {
        gvcp_stop_heartbeat(device->channel);
        if (device->has_control)
            (void)gvcp_write_register(device->channel, GVCP_CONTROL_PRIVILEGE, 0);
        gvcp_close(device->channel);
    }
    pthread_cond_destroy(&device->changed);
    pthread_mutex_destroy(&device->lock);
    free(device);
}

GC_ERROR device_open(struct interface *interface, const struct camera *camera, int32_t access,
                     struct device **result)
{
    if (access < DEVICE_ACCESS_READONLY || access > DEVICE_ACCESS_EXCLUSIVE)
        return fail(GC_ERR_INVALID_PARAMETER, "access %d; allowed: read only, control, exclusive",
                    access);
    struct device *device = calloc(1, sizeof *device);
    if (!device)
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory for a device");
    device->interface = interface;
    device->camera = *camera;
    device->access = access;
    pthread_mutex_init(&device->lock, NULL);
    condition_init(&device->changed);
    device->error = (struct event){.type = EVENT_ERROR,
                                   .lock = &device->lock,
                                   .changed = &device->changed,
                                   .device = device};
    GC_ERROR error = connect_camera(device);
    if (!error && !make_handles(device))
        error = GC_ERR_OUT_OF_MEMORY;
    if (error) {
        free_device(device);
        return error;
    }
    device->next = interface->devices;
    interface->devices = device;
    *result = device;
    return GC_ERR_SUCCESS;
}

void device_close(struct device *device)
{
    if (device->stream)
        stream_close(device->stream);
    event_close(&device->error);
    interface_forget_device(device->interface, device);
    free_device(device);
}

static struct device *look_up(void *handle)
{
    struct device *device = handle_pin(handle, MODULE_DEVICE);
    if (device)
        handle_unpin(handle);
    return device;
}

GC_API DevClose(DEV_HANDLE handle)
{
    tree_lock();
    struct device *device = look_up(handle);
    if (device)
        device_close(device);
    tree_unlock();
    return device ? GC_ERR_SUCCESS : last_error_code();
}

/* Who controls a camera that is not open here; it costs a question to the camera. */
static int32_t ask_access_status(const struct camera *camera)
{
    struct gvcp *channel;
    uint32_t privilege;
    if (gvcp_open(&camera->address, (struct in_addr){INADDR_ANY}, &channel))
        return DEVICE_ACCESS_STATUS_NOACCESS;
    GC_ERROR error = gvcp_read_register(channel, GVCP_CONTROL_PRIVILEGE, &privilege);
    gvcp_close(channel);
    if (error || (privilege & GVCP_EXCLUSIVE))
        return DEVICE_ACCESS_STATUS_NOACCESS;
    return privilege & GVCP_CONTROL ? DEVICE_ACCESS_STATUS_READONLY
                                    : DEVICE_ACCESS_STATUS_READWRITE;
}

GC_ERROR camera_info(const struct camera *camera, int32_t command, struct answer answer)
{
    char name[sizeof camera->model + sizeof camera->id + 4];
    switch (command) {
    case DEVICE_INFO_ID:
        return answer_string(answer, camera->id);
    case DEVICE_INFO_VENDOR:
        return answer_string(answer, camera->vendor);
    case DEVICE_INFO_MODEL:
        return answer_string(answer, camera->model);
    case DEVICE_INFO_TLTYPE:
        return answer_string(answer, TRANSPORT);
    case DEVICE_INFO_DISPLAYNAME:
        snprintf(name, sizeof name, "%s (%s)", camera->model, camera->id);
        return answer_string(answer, name);
    case DEVICE_INFO_ACCESS_STATUS:
        return answer_int32(answer, ask_access_status(camera));
    case DEVICE_INFO_USER_DEFINED_NAME:
        return answer_string(answer, camera->user_name);
    case DEVICE_INFO_SERIAL_NUMBER:
        return answer_string(answer, camera->serial);
    case DEVICE_INFO_VERSION:
        return answer_string(answer, camera->version);
    case DEVICE_INFO_TIMESTAMP_FREQUENCY:
        return fail(GC_ERR_NOT_AVAILABLE, "the tick frequency is known once the device is open");
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "device information %d is not known here", command);
    }
}

static int32_t access_status(const struct device *device)
{
    if (gvcp_is_lost(device->channel))
        return DEVICE_ACCESS_STATUS_NOACCESS;
    return device->access >= DEVICE_ACCESS_CONTROL ? DEVICE_ACCESS_STATUS_OPEN_READWRITE
                                                   : DEVICE_ACCESS_STATUS_OPEN_READONLY;
}

GC_ERROR device_info(struct device *device, int32_t command, struct answer answer)
{
    if (command == DEVICE_INFO_ACCESS_STATUS)
        return answer_int32(answer, access_status(device));
    if (command == DEVICE_INFO_TIMESTAMP_FREQUENCY)
        return answer_uint64(answer, device->tick_frequency);
    return camera_info(&device->camera, command, answer);
}

GC_API DevGetInfo(DEV_HANDLE handle, int32_t command, INFO_DATATYPE *type, void *buffer,
                  size_t *size)
{
    struct device *device = handle_pin(handle, MODULE_DEVICE);
    if (!device)
        return last_error_code();
    GC_ERROR error = device_info(device, command, (struct answer){type, buffer, size});
    handle_unpin(handle);
    return error;
}

GC_API DevGetParentIF(DEV_HANDLE handle, IF_HANDLE *result)
{
    struct device *device = handle_pin(handle, MODULE_DEVICE);
    if (!device)
        return last_error_code();
    *result = device->interface->handle;
    handle_unpin(handle);
    return GC_ERR_SUCCESS;
}

GC_API DevGetPort(DEV_HANDLE handle, PORT_HANDLE *result)
{
    struct device *device = handle_pin(handle, MODULE_DEVICE);
    if (!device)
        return last_error_code();
    *result = device->port_handle;
    handle_unpin(handle);
    return GC_ERR_SUCCESS;
}

GC_API DevGetNumDataStreams(DEV_HANDLE handle, uint32_t *count)
{
    if (!handle_pin(handle, MODULE_DEVICE))
        return last_error_code();
    *count = 1;
    handle_unpin(handle);
    return GC_ERR_SUCCESS;
}

GC_API DevGetDataStreamID(DEV_HANDLE handle, uint32_t index, char *id, size_t *size)
{
    if (!handle_pin(handle, MODULE_DEVICE))
        return last_error_code();
    handle_unpin(handle);
    if (index > 0)
        return fail(GC_ERR_INVALID_INDEX, "stream %u of 1", index);
    return answer_string((struct answer){NULL, id, size}, STREAM_ID);
}

GC_API DevOpenDataStream(DEV_HANDLE handle, const char *id, DS_HANDLE *result)
{
    GC_ERROR error;
    tree_lock();
    struct device *device = look_up(handle);
    if (!device)
        error = last_error_code();
    else if (!id || strcmp(id, STREAM_ID))
        error = fail(GC_ERR_INVALID_ID, "there is no stream '%s' but " STREAM_ID, id ? id : "");
    else if (device->stream)
        error = fail(GC_ERR_RESOURCE_IN_USE, "the stream is open already");
    else
        error = stream_open(device, result);
    tree_unlock();
    return error;
}
