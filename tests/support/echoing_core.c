/* A core that answers what it was told, to see that examples/cores/tronlab_core.h reads it right.
 *
 * uv_inliers are, one after the other: time_s, seed, the first and last grey value, the last depth
 * of the last reference view, setting "number", the last coefficient of distortion, and the bytes
 * of setting "text". The pose is the prior.
 */
#include "tronlab_core.h"

#define MAX_TEXT 200

static double values[7 + MAX_TEXT + 1];
static tlc_setup told;

static bool setup(void *state, const tlc_setup *setup, char reason[TLC_REASON_BYTES])
{
    (void)state;
    told = *setup;
    printf("this would break the messages if it got between them\n");
    fflush(stdout);
    return !tlc_json_string(tlc_json_get(told.settings, "fail"), reason, TLC_REASON_BYTES);
}

static double last_of(const tlc_array *array)
{
    return tlc_at(array, array->rows - 1, array->columns - 1);
}

static void locate(void *state, const tlc_frame *frame, tlc_result *result)
{
    char text[MAX_TEXT];
    size_t n = 0;
    bool is_true = false;
    (void)state;
    values[n++] = frame->time_s;
    values[n++] = (double)told.seed;
    values[n++] = tlc_at(&frame->image, 0, 0);
    values[n++] = last_of(&frame->image);
    values[n++] = told.n_references ? last_of(&told.references[told.n_references - 1].depth_m) : -1;
    if (!tlc_json_number(tlc_json_get(told.settings, "number"), &values[n++])) {
        values[n - 1] = -1;
    }
    values[n++] = told.camera.distortion[TLC_N_DISTORTION - 1];
    if (tlc_json_string(tlc_json_get(told.settings, "text"), text, sizeof text)) {
        for (const char *at = text; *at; at++) {
            values[n++] = (unsigned char)*at;
        }
    }
    for (size_t row = 0; row < frame->mask.rows; row++) {
        for (size_t column = 0; column < frame->mask.columns; column++) {
            result->n_features += tlc_at(&frame->mask, row, column) != 0;
        }
    }
    values[n] = 0;
    result->n_inliers = (long)(n + 1) / 2;
    result->uv_inliers = values;
    result->n_matches = (long)told.n_references;
    result->has_pose = result->has_covariance = frame->has_prior;
    result->pose = frame->prior;
    memcpy(result->covariance, frame->prior_covariance, sizeof result->covariance);
    if (tlc_json_bool(tlc_json_get(told.settings, "nan"), &is_true) && is_true) {
        result->pose.position_m[1] = (double)NAN;
    }
    snprintf(result->reason, TLC_REASON_BYTES, "%s", "a \"quoted\" \\ reason\n\xc3\xa9");
}

int main(int argc, char **argv)
{
    tlc_core core = tlc_core_named("echo", "2.5");
    core.identity = "build 7";
    core.references = true;
    core.setup = setup;
    core.locate = locate;
    return tlc_serve(&core, argc, argv);
}
