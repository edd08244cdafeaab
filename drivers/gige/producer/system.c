/* The system and its interfaces: one for each route that the environment names. */
#include <stdlib.h>
#include <string.h>

#include "modules.h"

static struct system *the_system; /* guarded by the tree's lock */

/* Objects found while the tree is locked cannot be closed meanwhile: no pin is held. */
static void *look_up(void *handle, enum module_kind kind)
{
    void *object = handle_pin(handle, kind);
    if (object)
        handle_unpin(handle);
    return object;
}

static void interface_close(struct interface *interface)
{
    while (interface->devices)
        device_close(interface->devices);
    if (interface->handle)
        handle_retire(interface->handle);
    interface->handle = NULL;
}

void system_close(void)
{
    if (!the_system)
        return;
    for (size_t i = 0; i < the_system->n_interfaces; i++) {
        interface_close(the_system->interfaces[i]);
        free(the_system->interfaces[i]);
    }
    handle_retire(the_system->handle);
    free(the_system);
    the_system = NULL;
}

void interface_forget_device(struct interface *interface, struct device *device)
{
    struct device **link = &interface->devices;
    while (*link != device)
        link = &(*link)->next;
    *link = device->next;
}

static GC_ERROR system_open(void **handle)
{
    if (!library_is_open())
        return fail(GC_ERR_NOT_INITIALIZED, "call GCInitLib first");
    if (the_system)
        return fail(GC_ERR_RESOURCE_IN_USE, "the system is open already");
    struct system *system = calloc(1, sizeof *system);
    if (system)
        system->handle = handle_new(MODULE_SYSTEM, system);
    if (!system || !system->handle) {
        free(system);
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory for the system");
    }
    the_system = system;
    *handle = system->handle;
    return GC_ERR_SUCCESS;
}

GC_API TLOpen(TL_HANDLE *system)
{
    if (!system)
        return fail(GC_ERR_INVALID_PARAMETER, "TLOpen: the pointer to the handle is NULL");
    tree_lock();
    GC_ERROR error = system_open(system);
    tree_unlock();
    return error;
}

GC_API TLClose(TL_HANDLE handle)
{
    tree_lock();
    bool is_known = look_up(handle, MODULE_SYSTEM) != NULL;
    if (is_known)
        system_close();
    tree_unlock();
    return is_known ? GC_ERR_SUCCESS : last_error_code();
}

GC_API TLGetInfo(TL_HANDLE handle, int32_t command, INFO_DATATYPE *type, void *buffer,
                 size_t *size)
{
    if (!handle_pin(handle, MODULE_SYSTEM))
        return last_error_code();
    handle_unpin(handle);
    return GCGetInfo(command, type, buffer, size);
}

static struct interface *find_interface(struct system *system, const char *name)
{
    for (size_t i = 0; name && i < system->n_interfaces; i++)
        if (!strcmp(system->interfaces[i]->route.name, name))
            return system->interfaces[i];
    fail(GC_ERR_INVALID_ID, "there is no interface '%s'; it must be named in " ROUTES_VARIABLE,
         name ? name : "");
    return NULL;
}

static bool is_listed(const struct interface *interface, const struct route *routes,
                      size_t n_routes)
{
    for (size_t i = 0; i < n_routes; i++)
        if (!strcmp(routes[i].name, interface->route.name))
            return true;
    return false;
}

/* Forget interfaces that are named no more, unless they are in use. */
static bool drop_unlisted(struct system *system, const struct route *routes, size_t n_routes)
{
    size_t n_kept = 0;
    for (size_t i = 0; i < system->n_interfaces; i++) {
        struct interface *interface = system->interfaces[i];
        if (interface->handle || is_listed(interface, routes, n_routes))
            system->interfaces[n_kept++] = interface;
        else
            free(interface);
    }
    bool has_changed = n_kept != system->n_interfaces;
    system->n_interfaces = n_kept;
    return has_changed;
}

static GC_ERROR add_listed(struct system *system, const struct route *routes, size_t n_routes,
                           bool *has_changed)
{
    for (size_t i = 0; i < n_routes; i++) {
        bool is_known = false;
        for (size_t k = 0; k < system->n_interfaces; k++)
            is_known |= is_listed(system->interfaces[k], &routes[i], 1);
        if (is_known)
            continue;
        if (system->n_interfaces == MAX_ROUTES)
            return fail(GC_ERR_RESOURCE_EXHAUSTED, "more than %d interfaces", MAX_ROUTES);
        struct interface *interface = calloc(1, sizeof *interface);
        if (!interface)
            return fail(GC_ERR_OUT_OF_MEMORY, "no memory for an interface");
        interface->system = system;
        interface->route = routes[i];
        system->interfaces[system->n_interfaces++] = interface;
        *has_changed = true;
    }
    return GC_ERR_SUCCESS;
}

GC_API TLUpdateInterfaceList(TL_HANDLE handle, bool8_t *changed, uint64_t timeout_ms)
{
    (void)timeout_ms; /* listing takes no time */
    struct route routes[MAX_ROUTES];
    size_t n_routes;
    tree_lock();
    struct system *system = look_up(handle, MODULE_SYSTEM);
    const char *list = getenv(ROUTES_VARIABLE);
    GC_ERROR error = system ? routes_parse(list ? list : ROUTES_DEFAULT, routes, &n_routes)
                            : last_error_code();
    if (!error) {
        bool has_changed = drop_unlisted(system, routes, n_routes);
        error = add_listed(system, routes, n_routes, &has_changed);
        if (changed)
            *changed = has_changed;
    }
    tree_unlock();
    return error;
}

GC_API TLGetNumInterfaces(TL_HANDLE handle, uint32_t *count)
{
    if (!count)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the count is NULL");
    tree_lock();
    struct system *system = look_up(handle, MODULE_SYSTEM);
    if (system)
        *count = (uint32_t)system->n_interfaces;
    tree_unlock();
    return system ? GC_ERR_SUCCESS : last_error_code();
}

GC_API TLGetInterfaceID(TL_HANDLE handle, uint32_t index, char *id, size_t *size)
{
    tree_lock();
    struct system *system = look_up(handle, MODULE_SYSTEM);
    GC_ERROR error;
    if (!system)
        error = last_error_code();
    else if (index >= system->n_interfaces)
        error = fail(GC_ERR_INVALID_INDEX, "interface %u of %zu", index, system->n_interfaces);
    else
        error = answer_string((struct answer){NULL, id, size},
                              system->interfaces[index]->route.name);
    tree_unlock();
    return error;
}

static GC_ERROR interface_info(const struct interface *interface, int32_t command,
                               struct answer answer)
{
    switch (command) {
    case INTERFACE_INFO_ID:
    case INTERFACE_INFO_DISPLAYNAME:
        return answer_string(answer, interface->route.name);
    case INTERFACE_INFO_TLTYPE:
        return answer_string(answer, TRANSPORT);
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "interface information %d is not known here", command);
    }
}

GC_API TLGetInterfaceInfo(TL_HANDLE handle, const char *id, int32_t command, INFO_DATATYPE *type,
                          void *buffer, size_t *size)
{
    tree_lock();
    struct system *system = look_up(handle, MODULE_SYSTEM);
    struct interface *interface = system ? find_interface(system, id) : NULL;
    GC_ERROR error = interface
                         ? interface_info(interface, command, (struct answer){type, buffer, size})
                         : last_error_code();
    tree_unlock();
    return error;
}

GC_API TLOpenInterface(TL_HANDLE handle, const char *id, IF_HANDLE *result)
{
    GC_ERROR error = GC_ERR_SUCCESS;
    tree_lock();
    struct system *system = look_up(handle, MODULE_SYSTEM);
    struct interface *interface = system ? find_interface(system, id) : NULL;
    if (!interface)
        error = last_error_code();
    else if (interface->handle)
        error = fail(GC_ERR_RESOURCE_IN_USE, "interface '%s' is open already", id);
    else if (!(interface->handle = handle_new(MODULE_INTERFACE, interface)))
        error = last_error_code();
    else
        *result = interface->handle;
    tree_unlock();
    return error;
}

GC_API IFClose(IF_HANDLE handle)
{
    tree_lock();
    struct interface *interface = look_up(handle, MODULE_INTERFACE);
    if (interface)
        interface_close(interface);
    tree_unlock();
    return interface ? GC_ERR_SUCCESS : last_error_code();
}

GC_API IFGetInfo(IF_HANDLE handle, int32_t command, INFO_DATATYPE *type, void *buffer,
                 size_t *size)
{
    struct interface *interface = handle_pin(handle, MODULE_INTERFACE);
    if (!interface)
        return last_error_code();
    GC_ERROR error = interface_info(interface, command, (struct answer){type, buffer, size});
    handle_unpin(handle);
    return error;
}

GC_API IFGetParentTL(IF_HANDLE handle, TL_HANDLE *result)
{
    struct interface *interface = handle_pin(handle, MODULE_INTERFACE);
    if (!interface)
        return last_error_code();
    *result = interface->system->handle;
    handle_unpin(handle);
    return GC_ERR_SUCCESS;
}

/* A camera that is open is kept, whatever it answers: its heartbeat knows better. */
static size_t add_open_cameras(const struct interface *interface, struct camera *cameras,
                               size_t n_cameras)
{
    for (struct device *device = interface->devices; device; device = device->next) {
        bool is_found = false;
        for (size_t i = 0; i < n_cameras; i++)
            is_found |= !strcmp(cameras[i].id, device->camera.id);
        if (!is_found && n_cameras < MAX_CAMERAS)
            cameras[n_cameras++] = device->camera;
    }
    return n_cameras;
}

GC_API IFUpdateDeviceList(IF_HANDLE handle, bool8_t *changed, uint64_t timeout_ms)
{
    struct camera cameras[MAX_CAMERAS];
    size_t n_cameras = 0;
    tree_lock();
    struct interface *interface = look_up(handle, MODULE_INTERFACE);
    GC_ERROR error = interface ? discover(&interface->route, timeout_ms, cameras, &n_cameras)
                               : last_error_code();
    if (!error) {
        n_cameras = add_open_cameras(interface, cameras, n_cameras);
        bool has_changed = n_cameras != interface->n_cameras;
        for (size_t i = 0; i < n_cameras && !has_changed; i++)
            has_changed = strcmp(cameras[i].id, interface->cameras[i].id) != 0;
        memcpy(interface->cameras, cameras, n_cameras * sizeof cameras[0]);
        interface->n_cameras = n_cameras;
        if (changed)
            *changed = has_changed;
    }
    tree_unlock();
    return error;
}

GC_API IFGetNumDevices(IF_HANDLE handle, uint32_t *count)
{
    if (!count)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the count is NULL");
    tree_lock();
    struct interface *interface = look_up(handle, MODULE_INTERFACE);
    if (interface)
        *count = (uint32_t)interface->n_cameras;
    tree_unlock();
    return interface ? GC_ERR_SUCCESS : last_error_code();
}

GC_API IFGetDeviceID(IF_HANDLE handle, uint32_t index, char *id, size_t *size)
{
    tree_lock();
    struct interface *interface = look_up(handle, MODULE_INTERFACE);
    GC_ERROR error;
    if (!interface)
        error = last_error_code();
    else if (index >= interface->n_cameras)
        error = fail(GC_ERR_INVALID_INDEX, "camera %u of %zu", index, interface->n_cameras);
    else
        error = answer_string((struct answer){NULL, id, size}, interface->cameras[index].id);
    tree_unlock();
    return error;
}

static const struct camera *find_camera(const struct interface *interface, const char *id)
{
    for (size_t i = 0; id && i < interface->n_cameras; i++)
        if (!strcmp(interface->cameras[i].id, id))
            return &interface->cameras[i];
    fail(GC_ERR_INVALID_ID, "interface '%s' has no camera '%s'", interface->route.name,
         id ? id : "");
    return NULL;
}

static struct device *find_device(const struct interface *interface, const char *id)
{
    struct device *device = interface->devices;
    while (device && strcmp(device->camera.id, id))
        device = device->next;
    return device;
}

GC_API IFGetDeviceInfo(IF_HANDLE handle, const char *id, int32_t command, INFO_DATATYPE *type,
                       void *buffer, size_t *size)
{
    struct answer answer = {type, buffer, size};
    GC_ERROR error;
    tree_lock();
    struct interface *interface = look_up(handle, MODULE_INTERFACE);
    const struct camera *camera = interface ? find_camera(interface, id) : NULL;
    struct device *device = camera ? find_device(interface, id) : NULL;
    if (!camera)
        error = last_error_code();
    else if (device)
        error = device_info(device, command, answer);
    else
        error = camera_info(camera, command, answer);
    tree_unlock();
    return error;
}

GC_API IFOpenDevice(IF_HANDLE handle, const char *id, int32_t access, DEV_HANDLE *result)
{
    GC_ERROR error = GC_ERR_SUCCESS;
    struct device *device;
    tree_lock();
    struct interface *interface = look_up(handle, MODULE_INTERFACE);
    const struct camera *camera = interface ? find_camera(interface, id) : NULL;
    if (!camera)
        error = last_error_code();
    else if (find_device(interface, id))
        error = fail(GC_ERR_RESOURCE_IN_USE, "camera '%s' is open already", id);
    else
        error = device_open(interface, camera, access, &device);
    if (!error)
        *result = device->handle;
    tree_unlock();
    return error;
}
