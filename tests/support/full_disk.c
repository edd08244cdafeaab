/* A disk that is full after so many bytes: laid over the C library by LD_PRELOAD.
 *
 * DISK_BUDGET is how many bytes may be written to files whose path has DISK_FOLDER in it. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static long budget(void)
{
    static long left = -1;
    static int is_read = 0;
    if (!is_read) {
        const char *text = getenv("DISK_BUDGET");
        left = text ? atol(text) : -1;
        is_read = 1;
    }
    return left;
}

static long written;

static int is_on_disk(int fd)
{
    char link[64], path[4096];
    const char *folder = getenv("DISK_FOLDER");
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0 || !folder)
        return 0;
    path[length] = 0;
    return strstr(path, folder) != NULL;
}

static int is_full(int fd, size_t size)
{
    if (budget() < 0 || !is_on_disk(fd))
        return 0;
    written += (long)size;
    return written > budget();
}

ssize_t write(int fd, const void *data, size_t size)
{
    static ssize_t (*real)(int, const void *, size_t);
    if (!real)
        real = dlsym(RTLD_NEXT, "write");
    if (is_full(fd, size)) {
        errno = ENOSPC;
        return -1;
    }
    return real(fd, data, size);
}

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t offset)
{
    static ssize_t (*real)(int, const void *, size_t, off64_t);
    if (!real)
        real = dlsym(RTLD_NEXT, "pwrite64");
    if (is_full(fd, size)) {
        errno = ENOSPC;
        return -1;
    }
    return real(fd, data, size, offset);
}

ssize_t pwrite(int fd, const void *data, size_t size, off_t offset)
{
    return pwrite64(fd, data, size, offset);
}
