/* What a consumer can ask of a buffer and of the frame in it. */
#include "modules.h"

/* What is true of a buffer whatever it holds. */
static GC_ERROR memory_info(const struct buffer *buffer, int32_t command, struct answer answer)
{
    switch (command) {
    case BUFFER_INFO_BASE:
        return answer_pointer(answer, buffer->frame.base);
    case BUFFER_INFO_SIZE:
        return answer_size(answer, buffer->frame.size);
    case BUFFER_INFO_USER_PTR:
        return answer_pointer(answer, buffer->user_pointer);
    case BUFFER_INFO_NEW_DATA:
        return answer_bool(answer, buffer->has_new_data);
    case BUFFER_INFO_IS_QUEUED:
        return answer_bool(answer, buffer->state != BUFFER_IDLE);
    case BUFFER_INFO_IS_ACQUIRING:
        return answer_bool(answer, buffer->state == BUFFER_FILLING);
    case BUFFER_INFO_TLTYPE:
        return answer_string(answer, TRANSPORT);
    case BUFFER_INFO_PIXELFORMAT_NAMESPACE:
        return answer_uint64(answer, PIXELFORMAT_NAMESPACE_GEV);
    case BUFFER_INFO_PIXEL_ENDIANNESS:
        return answer_int32(answer, PIXELENDIANNESS_LITTLE);
    case BUFFER_INFO_IMAGEOFFSET:
    case BUFFER_INFO_DELIVERED_CHUNKPAYLOADSIZE:
        return answer_size(answer, 0);
    case BUFFER_INFO_IS_COMPOSITE:
        return answer_bool(answer, false);
    default:
        return GC_ERR_NOT_IMPLEMENTED;
    }
}

static GC_ERROR frame_info(const struct frame *frame, int32_t command, struct answer answer)
{
    switch (command) {
    case BUFFER_INFO_TIMESTAMP:
        return answer_uint64(answer, frame->image.timestamp_ticks);
    case BUFFER_INFO_IS_INCOMPLETE:
        return answer_bool(answer, frame->is_incomplete);
    case BUFFER_INFO_SIZE_FILLED:
    case BUFFER_INFO_DATA_SIZE:
        return answer_size(answer, frame->filled);
    case BUFFER_INFO_FRAMEID:
        return answer_uint64(answer, frame->block_id);
    case BUFFER_INFO_IMAGEPRESENT:
        return answer_bool(answer, frame->has_image);
    case BUFFER_INFO_PAYLOADTYPE:
        return answer_size(answer, frame->has_image ? PAYLOAD_TYPE_IMAGE : PAYLOAD_TYPE_UNKNOWN);
    case BUFFER_INFO_DATA_LARGER_THAN_BUFFER:
        return answer_bool(answer, frame->is_too_large);
    case BUFFER_INFO_CONTAINS_CHUNKDATA:
        return answer_bool(answer, frame->has_chunks);
    default:
        return GC_ERR_NOT_IMPLEMENTED;
    }
}

static GC_ERROR image_info(const struct frame *frame, int32_t command, struct answer answer)
{
    switch (command) {
    case BUFFER_INFO_WIDTH:
        return answer_size(answer, frame->image.width);
    case BUFFER_INFO_HEIGHT:
        return answer_size(answer, frame->image.height);
    case BUFFER_INFO_XOFFSET:
        return answer_size(answer, frame->image.offset_x);
    case BUFFER_INFO_YOFFSET:
        return answer_size(answer, frame->image.offset_y);
    case BUFFER_INFO_XPADDING:
        return answer_size(answer, frame->image.padding_x);
    case BUFFER_INFO_YPADDING:
        return answer_size(answer, frame->image.padding_y);
    case BUFFER_INFO_PIXELFORMAT:
        return answer_uint64(answer, frame->image.pixel_format);
    case BUFFER_INFO_DELIVERED_IMAGEHEIGHT:
        return answer_size(answer, frame->lines);
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "buffer information %d is not known here", command);
    }
}

static GC_ERROR buffer_info(const struct buffer *buffer, int32_t command, struct answer answer)
{
    GC_ERROR error = memory_info(buffer, command, answer);
    if (error != GC_ERR_NOT_IMPLEMENTED)
        return error;
    if (buffer->state == BUFFER_FILLING)
        return fail(GC_ERR_NOT_AVAILABLE, "the buffer is being filled");
    error = frame_info(&buffer->frame, command, answer);
    return error == GC_ERR_NOT_IMPLEMENTED ? image_info(&buffer->frame, command, answer) : error;
}

GC_API DSGetBufferInfo(DS_HANDLE stream_handle, BUFFER_HANDLE buffer_handle, int32_t command,
                       INFO_DATATYPE *type, void *result, size_t *size)
{
    struct pair pair;
    if (!pin_pair(stream_handle, buffer_handle, &pair))
        return last_error_code();
    GC_ERROR error = buffer_info(pair.buffer, command, (struct answer){type, result, size});
    unpin_pair(stream_handle, buffer_handle, &pair);
    return error;
}
