/* Handles of the C interface: numbers, never pointers, so that a stale one is found out. */
#ifndef TRONLAB_HANDLES_H
#define TRONLAB_HANDLES_H

#include "gentl.h"

enum module_kind {
    MODULE_SYSTEM = 1,
    MODULE_INTERFACE,
    MODULE_DEVICE,
    MODULE_REMOTE_DEVICE, /* the port to the camera's own registers */
    MODULE_STREAM,
    MODULE_BUFFER,
    MODULE_EVENT,
};

/* A new handle of an object; NULL if memory is short. */
void *handle_new(enum module_kind kind, void *object);

/* The object of a handle, which will not be freed before handle_unpin. NULL, with the thread's
 * error set, if the handle is not of this kind or its module was closed. */
void *handle_pin(void *handle, enum module_kind kind);

/* As handle_pin, of any kind. */
void *handle_pin_any(void *handle, enum module_kind *kind);

void handle_unpin(void *handle);

/* Make the handle invalid and wait until nobody uses its object. */
void handle_retire(void *handle);

#endif
