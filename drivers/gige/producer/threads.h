/* A thread that can be stopped while it waits. */
#ifndef TRONLAB_THREADS_H
#define TRONLAB_THREADS_H

#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>

#include "gentl.h"

struct stoppable_thread {
    pthread_t thread;
    bool is_running;
    int stop_event; /* readable once the thread shall end */
    void (*run)(void *context);
    void *context;
};

/* Begin `run`, with all signals blocked: they are the consumer's. */
GC_ERROR thread_start(struct stoppable_thread *thread, void (*run)(void *context),
                      void *context);

/* Ask the thread to end and wait for it; harmless if it does not run. */
void thread_stop(struct stoppable_thread *thread);

/* Called by the thread: wait, and tell whether it was stopped meanwhile. */
bool thread_is_stopped(const struct stoppable_thread *thread, uint64_t wait_us);

/* A condition variable whose timeouts run on the monotonic clock. */
void condition_init(pthread_cond_t *condition);

#endif
