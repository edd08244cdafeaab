#include "threads.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "answer.h"
#include "wire.h"

static void *enter(void *argument)
{
    struct stoppable_thread *thread = argument;
    thread->run(thread->context);
    return NULL;
}

GC_ERROR thread_start(struct stoppable_thread *thread, void (*run)(void *context), void *context)
{
    sigset_t all, before;
    thread->run = run;
    thread->context = context;
    thread->stop_event = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (thread->stop_event < 0)
        return fail(GC_ERR_RESOURCE_EXHAUSTED, "no event descriptor: %s", strerror(errno));
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    int error = pthread_create(&thread->thread, NULL, enter, thread);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    if (error) {
        close(thread->stop_event);
        return fail(GC_ERR_RESOURCE_EXHAUSTED, "no thread: %s", strerror(error));
    }
    thread->is_running = true;
    return GC_ERR_SUCCESS;
}

void thread_stop(struct stoppable_thread *thread)
{
    if (!thread->is_running)
        return;
    uint64_t one = 1;
    (void)!write(thread->stop_event, &one, sizeof one);
    pthread_join(thread->thread, NULL);
    close(thread->stop_event);
    thread->is_running = false;
}

bool thread_is_stopped(const struct stoppable_thread *thread, uint64_t wait_us)
{
    struct pollfd stopped = {.fd = thread->stop_event, .events = POLLIN};
    struct timespec wait = timespec_from_us(wait_us);
    return ppoll(&stopped, 1, &wait, NULL) > 0;
}

void condition_init(pthread_cond_t *condition)
{
    pthread_condattr_t attributes;
    pthread_condattr_init(&attributes);
    pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
    pthread_cond_init(condition, &attributes);
    pthread_condattr_destroy(&attributes);
}
