#include "answer.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static _Thread_local GC_ERROR last_code;
static _Thread_local char last_text[256] = "no error";

GC_ERROR fail(GC_ERROR code, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(last_text, sizeof last_text, format, arguments);
    va_end(arguments);
    last_code = code;
    return code;
}

const char *last_error_text(void)
{
    return last_text;
}

GC_ERROR last_error_code(void)
{
    return last_code;
}

static GC_ERROR copy(struct answer answer, INFO_DATATYPE type, const void *value, size_t size)
{
    if (!answer.size)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the size is NULL");
    if (answer.type)
        *answer.type = type;
    size_t room = *answer.size;
    *answer.size = size;
    if (!answer.buffer)
        return GC_ERR_SUCCESS;
    if (room < size)
        return fail(GC_ERR_BUFFER_TOO_SMALL, "the answer needs %zu bytes, not %zu", size, room);
    memcpy(answer.buffer, value, size);
    return GC_ERR_SUCCESS;
}

GC_ERROR answer_string(struct answer answer, const char *text)
{
    return copy(answer, INFO_DATATYPE_STRING, text, strlen(text) + 1);
}

GC_ERROR answer_bool(struct answer answer, int value)
{
    bool8_t is_true = value != 0;
    return copy(answer, INFO_DATATYPE_BOOL8, &is_true, sizeof is_true);
}

GC_ERROR answer_int32(struct answer answer, int32_t value)
{
    return copy(answer, INFO_DATATYPE_INT32, &value, sizeof value);
}

GC_ERROR answer_uint32(struct answer answer, uint32_t value)
{
    return copy(answer, INFO_DATATYPE_UINT32, &value, sizeof value);
}

GC_ERROR answer_uint64(struct answer answer, uint64_t value)
{
    return copy(answer, INFO_DATATYPE_UINT64, &value, sizeof value);
}

GC_ERROR answer_size(struct answer answer, size_t value)
{
    return copy(answer, INFO_DATATYPE_SIZET, &value, sizeof value);
}

GC_ERROR answer_pointer(struct answer answer, void *value)
{
    return copy(answer, INFO_DATATYPE_PTR, &value, sizeof value);
}
