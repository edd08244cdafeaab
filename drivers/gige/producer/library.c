/* The library itself: opening, its last error, its own description. */
#include <dlfcn.h>
#include <string.h>

#include "modules.h"

static pthread_mutex_t tree = PTHREAD_MUTEX_INITIALIZER;
static _Atomic bool is_open;

bool library_is_open(void)
{
    return is_open;
}

void tree_lock(void)
{
    pthread_mutex_lock(&tree);
}

void tree_unlock(void)
{
    pthread_mutex_unlock(&tree);
}

GC_API GCInitLib(void)
{
    tree_lock();
    bool was_open = is_open;
    is_open = true;
    tree_unlock();
    return was_open ? fail(GC_ERR_RESOURCE_IN_USE, "the library is open already")
                    : GC_ERR_SUCCESS;
}

GC_API GCCloseLib(void)
{
    tree_lock();
    bool was_open = is_open;
    if (was_open)
        system_close();
    is_open = false;
    tree_unlock();
    return was_open ? GC_ERR_SUCCESS : fail(GC_ERR_NOT_INITIALIZED, "the library is not open");
}

static const char *own_path(void)
{
    static const char anchor; /* something that is in this library */
    Dl_info info;
    return dladdr(&anchor, &info) && info.dli_fname ? info.dli_fname : PRODUCER_NAME ".cti";
}

GC_API GCGetInfo(int32_t command, INFO_DATATYPE *type, void *buffer, size_t *size)
{
    struct answer answer = {type, buffer, size};
    switch (command) {
    case TL_INFO_ID:
    case TL_INFO_MODEL:
        return answer_string(answer, PRODUCER_NAME);
    case TL_INFO_VENDOR:
        return answer_string(answer, PRODUCER_VENDOR);
    case TL_INFO_VERSION:
        return answer_string(answer, PRODUCER_VERSION);
    case TL_INFO_TLTYPE:
        return answer_string(answer, TRANSPORT);
    case TL_INFO_NAME:
        return answer_string(answer, PRODUCER_NAME ".cti");
    case TL_INFO_PATHNAME:
        return answer_string(answer, own_path());
    case TL_INFO_DISPLAYNAME:
        return answer_string(answer, "tronlab GigE Vision producer");
    case TL_INFO_CHAR_ENCODING:
        return answer_int32(answer, TL_CHAR_ENCODING_ASCII);
    case TL_INFO_GENTL_VER_MAJOR:
        return answer_uint32(answer, 1);
    case TL_INFO_GENTL_VER_MINOR:
        return answer_uint32(answer, 5);
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "library information %d is not known here", command);
    }
}

GC_API GCGetLastError(GC_ERROR *code, char *text, size_t *size)
{
    if (!code || !size)
        return GC_ERR_INVALID_PARAMETER;
    *code = last_error_code();
    size_t room = *size;
    *size = strlen(last_error_text()) + 1;
    if (text && room < *size)
        return GC_ERR_BUFFER_TOO_SMALL;
    if (text)
        memcpy(text, last_error_text(), *size);
    return GC_ERR_SUCCESS;
}
