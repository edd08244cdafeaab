/* Functions of the C interface for payloads that a GC1380H never sends: chunk data, several parts,
 * segments or flows. They are here because consumers complain of a library without them. */
#include "answer.h"

static GC_ERROR not_offered(const char *what)
{
    return fail(GC_ERR_NOT_IMPLEMENTED, "%s are not read by this producer", what);
}

GC_API DSGetBufferChunkData(DS_HANDLE stream, BUFFER_HANDLE buffer, void *chunks, size_t *count)
{
    (void)stream, (void)buffer, (void)chunks, (void)count;
    return not_offered("chunk data");
}

GC_API DSGetNumBufferParts(DS_HANDLE stream, BUFFER_HANDLE buffer, uint32_t *count)
{
    (void)stream, (void)buffer, (void)count;
    return not_offered("multi-part payloads");
}

GC_API DSGetBufferPartInfo(DS_HANDLE stream, BUFFER_HANDLE buffer, uint32_t part, int32_t command,
                           INFO_DATATYPE *type, void *result, size_t *size)
{
    (void)stream, (void)buffer, (void)part, (void)command, (void)type, (void)result, (void)size;
    return not_offered("multi-part payloads");
}

GC_API DSAnnounceCompositeBuffer(DS_HANDLE stream, size_t n_segments, void **segments,
                                 size_t *sizes, void *user_pointer, BUFFER_HANDLE *buffer)
{
    (void)stream, (void)n_segments, (void)segments, (void)sizes, (void)user_pointer, (void)buffer;
    return not_offered("composite buffers");
}

GC_API DSGetNumFlows(DS_HANDLE stream, uint32_t *count)
{
    (void)stream, (void)count;
    return not_offered("flows");
}

GC_API DSGetFlowInfo(DS_HANDLE stream, uint32_t flow, int32_t command, INFO_DATATYPE *type,
                     void *result, size_t *size)
{
    (void)stream, (void)flow, (void)command, (void)type, (void)result, (void)size;
    return not_offered("flows");
}

GC_API DSGetNumBufferSegments(DS_HANDLE stream, BUFFER_HANDLE buffer, uint32_t *count)
{
    (void)stream, (void)buffer, (void)count;
    return not_offered("composite buffers");
}

GC_API DSGetBufferSegmentInfo(DS_HANDLE stream, BUFFER_HANDLE buffer, uint32_t segment,
                              int32_t command, INFO_DATATYPE *type, void *result, size_t *size)
{
    (void)stream, (void)buffer, (void)segment, (void)command, (void)type, (void)result, (void)size;
    return not_offered("composite buffers");
}
