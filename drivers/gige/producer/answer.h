/* How the C interface answers: values into the caller's buffer, and the thread's last error. */
#ifndef TRONLAB_ANSWER_H
#define TRONLAB_ANSWER_H

#include "gentl.h"

/* Where the answer to an information command goes; `type` may be NULL. */
struct answer {
    INFO_DATATYPE *type;
    void *buffer;
    size_t *size;
};

/* Remember the error for GCGetLastError of this thread and return its code. */
GC_ERROR fail(GC_ERROR code, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* The text of this thread's last error. */
const char *last_error_text(void);
GC_ERROR last_error_code(void);

/* Each copies a value, or tells only its size when the buffer is NULL. */
GC_ERROR answer_string(struct answer answer, const char *text);
GC_ERROR answer_bool(struct answer answer, int value);
GC_ERROR answer_int32(struct answer answer, int32_t value);
GC_ERROR answer_uint32(struct answer answer, uint32_t value);
GC_ERROR answer_uint64(struct answer answer, uint64_t value);
GC_ERROR answer_size(struct answer answer, size_t value);
GC_ERROR answer_pointer(struct answer answer, void *value);

#endif
