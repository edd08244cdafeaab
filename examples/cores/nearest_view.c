/* A navigation core that answers the pose of the reference view most like the image.
 *
 *     cc -O2 -o nearest_view nearest_view.c -lm
 *     tronlab score DATASET.h5 --core cmd:./nearest_view
 *
 * nearest_view.py does the same in Python.
 */
#include "tronlab_core.h"

typedef struct nearest_view {
    const tlc_reference *references;
    size_t n_references;
    double min_likeness; /* setting: less than this is no pose; -1 accepts everything */
} nearest_view;

static bool setup(void *state, const tlc_setup *setup, char reason[TLC_REASON_BYTES])
{
    nearest_view *core = (nearest_view *)state;
    core->references = setup->references;
    core->n_references = setup->n_references;
    core->min_likeness = -1;
    const tlc_json setting = tlc_json_get(setup->settings, "min_likeness");
    if (setting.at && !tlc_json_number(setting, &core->min_likeness)) {
        snprintf(reason, TLC_REASON_BYTES, "the setting min_likeness must be a number, -1 to 1");
        return false;
    }
    return true;
}

/* Give the mean of an image where both masks are set, and in how many pixels they are. */
static double masked_mean(const tlc_array *image, const tlc_array *mask, const tlc_array *other,
                          size_t *n)
{
    double sum = 0;
    *n = 0;
    for (size_t row = 0; row < image->rows; row++) {
        for (size_t column = 0; column < image->columns; column++) {
            if (tlc_at(mask, row, column) != 0 && tlc_at(other, row, column) != 0) {
                sum += tlc_at(image, row, column);
                ++*n;
            }
        }
    }
    return *n ? sum / (double)*n : 0;
}

/* Give the correlation of two images within both masks, -1 to 1; NaN if one of them is flat. */
static double likeness(const tlc_frame *frame, const tlc_reference *view)
{
    size_t n;
    const double mean_a = masked_mean(&frame->image, &frame->mask, &view->mask, &n);
    const double mean_b = masked_mean(&view->image, &frame->mask, &view->mask, &n);
    double aa = 0, bb = 0, ab = 0;
    for (size_t row = 0; row < view->image.rows; row++) {
        for (size_t column = 0; column < view->image.columns; column++) {
            if (tlc_at(&frame->mask, row, column) != 0 && tlc_at(&view->mask, row, column) != 0) {
                const double a = tlc_at(&frame->image, row, column) - mean_a;
                const double b = tlc_at(&view->image, row, column) - mean_b;
                aa += a * a;
                bb += b * b;
                ab += a * b;
            }
        }
    }
    return n && aa > 0 && bb > 0 ? ab / sqrt(aa * bb) : (double)NAN;
}

static void locate(void *state, const tlc_frame *frame, tlc_result *result)
{
    const nearest_view *core = (const nearest_view *)state;
    double best = (double)NAN;
    for (size_t i = 0; i < core->n_references; i++) {
        const double value = likeness(frame, &core->references[i]);
        if (!isnan(value) && !(value <= best)) { /* the first is better than NaN */
            best = value;
            result->pose = core->references[i].pose;
        }
    }
    result->has_pose = best >= core->min_likeness;
    if (isnan(best)) {
        snprintf(result->reason, TLC_REASON_BYTES, "the image resembles no reference view");
    } else if (!result->has_pose) {
        snprintf(result->reason, TLC_REASON_BYTES, "the nearest view has a likeness of only %.3f",
                 best);
    }
}

int main(int argc, char **argv)
{
    nearest_view state;
    tlc_core core = tlc_core_named("nearest-view", "1.0");
    core.references = true;
    core.state = &state;
    core.setup = setup;
    core.locate = locate;
    return tlc_serve(&core, argc, argv);
}
