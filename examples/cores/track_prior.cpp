/* A navigation core that keeps state: a Kalman filter that measures one shift a frame.
 *
 *     c++ -std=c++17 -O2 -o track_prior track_prior.cpp
 *     tronlab score DATASET.h5 --core cmd:./track_prior --prior truth:0.1,0.5
 *
 * It believes the prior it is offered, or else its own last answer, unless the image is more like a
 * reference view; draws the nearest reference view as seen from there; and finds by how much the
 * image is shifted against the drawing. That corrects the pose in what a shift tells of, sideways
 * above all, and leaves the range as believed.
 *
 * Settings: position_sigma_m and rotation_sigma_deg, how far the camera may get from the core's
 * last answer (0.1 and 1); min_likeness, the least correlation of image and drawing (0.5).
 */
#include "tronlab_core.h"

#include <algorithm>
#include <optional>
#include <vector>

namespace {

constexpr int CELLS_ACROSS = 48;     /* images are compared at this resolution */
constexpr int MAX_SHIFT = 8;         /* cells */
constexpr double SIGMA_CELLS = 0.07; /* standard deviation of a shift, found by experiment */
constexpr double START_SIGMA_M = 0.3, START_SIGMA_DEG = 3;
constexpr double RAD = 3.14159265358979323846 / 180;

struct Point { double p_trs[3], grey; };
struct View { tlc_pose pose; std::vector<Point> points; };
struct Cell { double sum = 0, n = 0; };
struct Shift { double uv_px[2], likeness; bool is_inside; };
struct Belief { tlc_pose pose; double covariance[6][6]; };
/* A belief, the mean in cam of the terrain it should see, and how the image is shifted by that. */
struct Comparison { Belief belief; double middle[3]; Shift shift; };

struct Tracker {
    tlc_camera camera;
    int cell_px, rows, columns; /* side of a cell, and how many there are */
    double position_sigma_m, rotation_sigma_deg, min_likeness;
    std::vector<View> views;
    std::optional<Belief> last;
};

std::vector<Point> points_of(const Tracker &core, const tlc_reference &view)
{
    std::vector<Point> points;
    const size_t stride = size_t(std::max(1, core.cell_px / 2));
    for (size_t row = 0; row < view.image.rows; row += stride) {
        for (size_t column = 0; column < view.image.columns; column += stride) {
            const double depth_m = tlc_at(&view.depth_m, row, column);
            if (tlc_at(&view.mask, row, column) != 0 && depth_m > 0) {
                double p[3];
                tlc_ray(&core.camera, double(column), double(row), p);
                std::for_each(p, p + 3, [&](double &value) { value *= depth_m; });
                points.push_back({{}, tlc_at(&view.image, row, column)});
                tlc_to_trs(&view.pose, p, points.back().p_trs);
            }
        }
    }
    return points;
}

void add_to_cell(const Tracker &core, std::vector<Cell> &cells, double u, double v, double grey)
{
    const double row = std::floor((v + 0.5) / core.cell_px);
    const double column = std::floor((u + 0.5) / core.cell_px);
    if (row >= 0 && row < core.rows && column >= 0 && column < core.columns) {
        Cell &cell = cells[size_t(row) * size_t(core.columns) + size_t(column)];
        cell.sum += grey;
        cell.n += 1;
    }
}

std::vector<Cell> cells_of(const Tracker &core, const tlc_frame &frame)
{
    std::vector<Cell> cells(size_t(core.rows * core.columns));
    for (size_t row = 0; row < frame.image.rows; row++) {
        for (size_t column = 0; column < frame.image.columns; column++) {
            if (tlc_at(&frame.mask, row, column) != 0) {
                add_to_cell(core, cells, double(column), double(row),
                            tlc_at(&frame.image, row, column));
            }
        }
    }
    return cells;
}

const View &nearest_view(const Tracker &core, const tlc_pose &pose)
{
    const auto distance = [&](const View &view) {
        const double *a = view.pose.position_m, *b = pose.position_m;
        return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    };
    return *std::min_element(
        core.views.begin(), core.views.end(),
        [&](const View &a, const View &b) { return distance(a) < distance(b); });
}

/* Draw what a pose should see; middle becomes the mean of the terrain it sees, in cam. */
std::vector<Cell> drawing_of(const Tracker &core, const tlc_pose &pose, double middle[3])
{
    std::vector<Cell> cells(size_t(core.rows * core.columns));
    double n = 0;
    for (const Point &point : nearest_view(core, pose).points) {
        double p[3], uv[2];
        tlc_to_cam(&pose, point.p_trs, p);
        if (p[2] <= 0 || std::abs(p[0] / p[2]) * core.camera.fx_px > core.camera.width_px
            || std::abs(p[1] / p[2]) * core.camera.fy_px > core.camera.height_px) {
            continue; /* far outside, where the lens model is no longer true */
        }
        tlc_project(&core.camera, p, uv);
        add_to_cell(core, cells, uv[0], uv[1], point.grey);
        n += 1;
        for (size_t i = 0; i < 3; i++) {
            middle[i] += (p[i] - middle[i]) / n;
        }
    }
    return cells;
}

/* Give the correlation of the image with the drawing moved by (du, dv) cells; -1 if unknown. */
double likeness(const Tracker &core, const std::vector<Cell> &image,
                const std::vector<Cell> &drawing, int du, int dv)
{
    double n = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0;
    for (int row = std::max(0, -dv); row < std::min(core.rows, core.rows - dv); row++) {
        for (int column = std::max(0, -du); column < std::min(core.columns, core.columns - du);
             column++) {
            const Cell &x = image[size_t((row + dv) * core.columns + column + du)];
            const Cell &y = drawing[size_t(row * core.columns + column)];
            if (x.n > 0 && y.n > 0) {
                const double p = x.sum / x.n, q = y.sum / y.n;
                n += 1, a += p, b += q, aa += p * p, bb += q * q, ab += p * q;
            }
        }
    }
    const double spread = (n * aa - a * a) * (n * bb - b * b);
    const bool is_enough = 10 * n > core.rows * core.columns && spread > 0;
    return is_enough ? (n * ab - a * b) / std::sqrt(spread) : -1;
}

Shift shift_of(const Tracker &core, const std::vector<Cell> &image,
               const std::vector<Cell> &drawing)
{
    int u = 0, v = 0;
    double best = -1;
    for (int dv = -MAX_SHIFT; dv <= MAX_SHIFT; dv++) {
        for (int du = -MAX_SHIFT; du <= MAX_SHIFT; du++) {
            if (const double at = likeness(core, image, drawing, du, dv); at > best) {
                best = at, u = du, v = dv;
            }
        }
    }
    const auto peak = [&](int du, int dv) { /* of the parabola through three neighbours */
        const double before = likeness(core, image, drawing, u - du, v - dv);
        const double after = likeness(core, image, drawing, u + du, v + dv);
        const double bend = before - 2 * best + after;
        return bend < 0 ? 0.5 * (before - after) / bend : 0;
    };
    const bool is_inside = std::max(std::abs(u), std::abs(v)) < MAX_SHIFT;
    return {{(u + peak(1, 0)) * core.cell_px, (v + peak(0, 1)) * core.cell_px}, best, is_inside};
}

/* Turn by a small rotation vector in trs, and move. */
void correct(tlc_pose &pose, const double by[6])
{
    const double x = by[0] / 2, y = by[1] / 2, z = by[2] / 2;
    double *q = pose.quaternion_xyzw;
    const double turned[4] = {q[0] + x * q[3] + y * q[2] - z * q[1],
                              q[1] + y * q[3] + z * q[0] - x * q[2],
                              q[2] + z * q[3] + x * q[1] - y * q[0],
                              q[3] - x * q[0] - y * q[1] - z * q[2]};
    const double norm = std::hypot(std::hypot(turned[0], turned[1]),
                                   std::hypot(turned[2], turned[3]));
    for (int i = 0; i < 4; i++) {
        q[i] = turned[i] / norm;
    }
    for (int i = 0; i < 3; i++) {
        pose.position_m[i] += by[3 + i];
    }
}

/* Kalman's update by u, then by v. With a the derivative of u by the middle c, and d from the
 * camera to c, all in trs, an error (dw, dt) of the pose shifts c by a . (d x dw - dt). */
void update(const Tracker &core, Belief &belief, const double c[3], const Shift &shift)
{
    const double f[2] = {core.camera.fx_px, core.camera.fy_px};
    const double noise_px = SIGMA_CELLS * core.cell_px;
    double r[9], by[6] = {};
    tlc_rotation(belief.pose.quaternion_xyzw, r);
    for (size_t axis = 0; axis < 2; axis++) {
        double a[3], d[3], h[6], ph[6] = {}, variance = noise_px * noise_px, expected = 0;
        for (size_t i = 0; i < 3; i++) {
            a[i] = f[axis] / c[2] * (r[3 * i + axis] - c[axis] / c[2] * r[3 * i + 2]);
            d[i] = r[3 * i] * c[0] + r[3 * i + 1] * c[1] + r[3 * i + 2] * c[2];
            h[3 + i] = -a[i];
        }
        for (size_t i = 0; i < 3; i++) {
            h[i] = a[(i + 1) % 3] * d[(i + 2) % 3] - a[(i + 2) % 3] * d[(i + 1) % 3];
        }
        for (size_t i = 0; i < 6; i++) {
            for (size_t j = 0; j < 6; j++) {
                ph[i] += belief.covariance[i][j] * h[j];
            }
            variance += h[i] * ph[i];
            expected += h[i] * by[i];
        }
        for (size_t i = 0; i < 6; i++) {
            by[i] += ph[i] / variance * (shift.uv_px[axis] - expected);
            for (size_t j = 0; j < 6; j++) {
                belief.covariance[i][j] -= ph[i] * ph[j] / variance;
            }
        }
    }
    correct(belief.pose, by);
}

Belief less_certain(Belief belief, double position_m, double rotation_deg)
{
    for (size_t i = 0; i < 6; i++) {
        const double sigma = i < 3 ? rotation_deg * RAD : position_m;
        belief.covariance[i][i] += sigma * sigma;
    }
    return belief;
}

/* What may be believed: each reference view, and the prior or else the core's own last answer. */
std::vector<Belief> beliefs_of(const Tracker &core, const tlc_frame &frame)
{
    std::vector<Belief> beliefs;
    for (const View &view : core.views) {
        beliefs.push_back(less_certain({view.pose, {}}, START_SIGMA_M, START_SIGMA_DEG));
    }
    if (frame.has_prior) {
        beliefs.push_back({frame.prior, {}});
        memcpy(beliefs.back().covariance, frame.prior_covariance, sizeof frame.prior_covariance);
    } else if (core.last) {
        beliefs.push_back(
            less_certain(*core.last, core.position_sigma_m, core.rotation_sigma_deg));
    }
    return beliefs;
}

/* Compare the image with what each belief should see; give the one it is most like. */
Comparison best_comparison(const Tracker &core, const tlc_frame &frame)
{
    const std::vector<Cell> image = cells_of(core, frame);
    Comparison best{};
    best.shift.likeness = -2;
    for (const Belief &belief : beliefs_of(core, frame)) {
        Comparison next{belief, {0, 0, 0}, {}};
        next.shift = shift_of(core, image, drawing_of(core, belief.pose, next.middle));
        if (next.shift.likeness > best.shift.likeness) {
            best = next;
        }
    }
    return best;
}

bool read_setting(tlc_json settings, const char *name, double &value, double otherwise)
{
    const tlc_json setting = tlc_json_get(settings, name);
    value = otherwise;
    return !setting.at || (tlc_json_number(setting, &value) && value >= 0);
}

bool setup(void *state, const tlc_setup *setup, char *reason)
{
    Tracker &core = *static_cast<Tracker *>(state);
    core = Tracker{};
    core.camera = setup->camera;
    core.cell_px = std::max(1, core.camera.width_px / CELLS_ACROSS);
    core.rows = core.camera.height_px / core.cell_px;
    core.columns = core.camera.width_px / core.cell_px;
    for (size_t i = 0; i < setup->n_references; i++) {
        core.views.push_back({setup->references[i].pose, points_of(core, setup->references[i])});
    }
    if (core.views.empty()) {
        snprintf(reason, TLC_REASON_BYTES, "there are no reference views");
        return false;
    }
    snprintf(reason, TLC_REASON_BYTES, "a setting is no number from 0");
    return read_setting(setup->settings, "position_sigma_m", core.position_sigma_m, 0.1)
           && read_setting(setup->settings, "rotation_sigma_deg", core.rotation_sigma_deg, 1)
           && read_setting(setup->settings, "min_likeness", core.min_likeness, 0.5);
}

void locate(void *state, const tlc_frame *frame, tlc_result *result)
{
    Tracker &core = *static_cast<Tracker *>(state);
    auto [belief, middle, shift] = best_comparison(core, *frame);
    core.last.reset();
    if (shift.likeness < core.min_likeness || !shift.is_inside) {
        snprintf(result->reason, TLC_REASON_BYTES,
                 "the image does not look as it should from where the camera is believed");
        return;
    }
    update(core, belief, middle, shift);
    core.last = belief;
    result->has_pose = result->has_covariance = true;
    result->pose = belief.pose;
    memcpy(result->covariance, belief.covariance, sizeof result->covariance);
}

void reset(void *state) { static_cast<Tracker *>(state)->last.reset(); }

} // namespace

int main(int argc, char **argv)
{
    Tracker state{};
    tlc_core core = tlc_core_named("track-prior", "1.0");
    core.sequential = core.references = true;
    core.state = &state;
    core.setup = setup;
    core.locate = locate;
    core.reset = reset;
    return tlc_serve(&core, argc, argv);
}
