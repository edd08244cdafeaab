#include "handles.h"

#include <pthread.h>
#include <stdlib.h>

#include "answer.h"
#include "modules.h"

/* A handle is the number of a slot and how often the slot was used before. */
enum { SLOT_BITS = 16, MAX_SLOTS = (1 << SLOT_BITS) - 1 };

struct slot {
    enum module_kind kind; /* 0: free */
    bool is_retired;
    void *object;
    unsigned n_pins;
    uintptr_t n_uses;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t unpinned = PTHREAD_COND_INITIALIZER;
static struct slot *slots;
static size_t n_slots;

static size_t index_of(void *handle)
{
    return ((uintptr_t)handle & MAX_SLOTS) - 1;
}

static void *handle_of(size_t index)
{
    return (void *)(slots[index].n_uses << SLOT_BITS | (index + 1));
}

static struct slot *find(void *handle)
{
    size_t index = index_of(handle);
    bool is_valid = index < n_slots && slots[index].kind && !slots[index].is_retired &&
                    handle_of(index) == handle;
    return is_valid ? &slots[index] : NULL;
}

/* The index of a free slot, n_slots if there is none. */
static size_t find_free(void)
{
    size_t index = 0;
    while (index < n_slots && slots[index].kind)
        index++;
    if (index < n_slots || n_slots == MAX_SLOTS)
        return index;
    size_t n_more = n_slots ? 2 * n_slots : 64;
    n_more = n_more < MAX_SLOTS ? n_more : MAX_SLOTS;
    struct slot *more = realloc(slots, n_more * sizeof *more);
    if (!more)
        return n_slots;
    slots = more;
    for (size_t i = n_slots; i < n_more; i++)
        slots[i] = (struct slot){0};
    n_slots = n_more;
    return index;
}

void *handle_new(enum module_kind kind, void *object)
{
    void *handle = NULL;
    pthread_mutex_lock(&lock);
    size_t index = find_free();
    if (index < n_slots) {
        slots[index] =
            (struct slot){.kind = kind, .object = object, .n_uses = slots[index].n_uses + 1};
        handle = handle_of(index);
    }
    pthread_mutex_unlock(&lock);
    if (!handle)
        fail(GC_ERR_OUT_OF_MEMORY, "no memory for a handle");
    return handle;
}

void *handle_pin_any(void *handle, enum module_kind *kind)
{
    void *object = NULL;
    pthread_mutex_lock(&lock);
    struct slot *slot = find(handle);
    if (slot) {
        slot->n_pins++;
        *kind = slot->kind;
        object = slot->object;
    }
    pthread_mutex_unlock(&lock);
    if (!object && library_is_open())
        fail(GC_ERR_INVALID_HANDLE, "%p is no handle of this library, or was closed", handle);
    else if (!object)
        fail(GC_ERR_NOT_INITIALIZED, "call GCInitLib first");
    return object;
}

void *handle_pin(void *handle, enum module_kind kind)
{
    enum module_kind found;
    void *object = handle_pin_any(handle, &found);
    if (!object || found == kind)
        return object;
    handle_unpin(handle);
    fail(GC_ERR_INVALID_HANDLE, "%p is a handle of another kind of module", handle);
    return NULL;
}

void handle_unpin(void *handle)
{
    pthread_mutex_lock(&lock);
    if (--slots[index_of(handle)].n_pins == 0)
        pthread_cond_broadcast(&unpinned);
    pthread_mutex_unlock(&lock);
}

void handle_retire(void *handle)
{
    size_t index = index_of(handle);
    pthread_mutex_lock(&lock);
    slots[index].is_retired = true;
    while (slots[index].n_pins)
        pthread_cond_wait(&unpinned, &lock);
    slots[index].kind = 0;
    pthread_mutex_unlock(&lock);
}
