"""The report of a plan: files, page, choice of pictures, and the projection of the cell."""

import csv
import io
import json
from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from planned import CAMERA, OUT_OF_REACH, planned, small_stage
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import ConfigError
from tronlab.report.plan import (
    PlanReport,
    build_plan_report,
    check_plan_folder,
    json_document,
)
from tronlab.report.plan_charts import shot_charts
from tronlab.report.plan_projection import View, draw_faces
from tronlab.report.plan_scene import elevation_pictures, perspective_picture
from tronlab.report.plan_solids import box, box_corners, capsule, line, terrain
from tronlab.report.plan_storyboard import MOST_REFUSED, N_EVEN, predict_views, story_shots
from tronlab.report.plan_tables import shots_table
from tronlab.report.style import new_figure
from tronlab.score.evaluation.export import to_csv


def report(assessment=None, *, stage=None) -> PlanReport:
    return PlanReport(
        title="Plan: <approach>",
        assessment=assessment or planned(),
        verdict="The campaign cannot run.",
        can_run=False,
        begun=datetime(2026, 11, 22, 9, 0),
        facts=[("campaign", "approach & hover")],
        documents={"campaign file": "name: a<b"},
        stage=stage,
    )


def save_coarsely(figure, directory, stem):
    """As charts are saved, in a moment."""
    path = directory / f"{stem}.png"
    figure.set_layout_engine("none")
    figure.set_dpi(20)
    FigureCanvasAgg(figure).print_png(path)
    return path


def test_report_has_page_pictures_tables_and_json(tmp_path, monkeypatch):
    monkeypatch.setattr("tronlab.report.plan.save_chart", save_coarsely)
    views = []
    page = build_plan_report(
        report(stage=small_stage()), tmp_path / "a" / "b", on_view=lambda *n: views.append(n)
    )
    assert page == tmp_path / "a" / "b" / "index.html"
    folder = page.parent
    assert sorted(path.name for path in folder.iterdir()) == [
        "figures",
        "index.html",
        "plan.json",
        "shots.csv",
    ]
    assert {path.name for path in (folder / "figures").glob("*.[pj][np]g")} == {
        "cell.png",
        "cell_elevations.png",
        "shots.png",
        "storyboard.jpg",
        "time.png",
    }
    assert views[-1] == (6, 6)
    html = page.read_text()
    assert html.count("data:image/") == 5, "the page needs nothing beside itself"
    assert "Plan: &lt;approach&gt;" in html
    assert "name: a&lt;b" in html
    assert OUT_OF_REACH.text in html
    assert "50 mm and 0.0 deg away" in html
    assert "All shots." in html


def test_json_has_all_shots_and_no_word_for_what_is_not_known():
    document = json.loads(json_document(report()), parse_constant=pytest.fail)
    assert document["can_run"] is False
    assert document["n_refused"] == 2
    assert document["checks"]["light"] == {"n_refused": 0, "n_warned": 2}
    assert document["total_s"] == pytest.approx(sum(document["parts_s"].values()))
    first, last = document["shots"][0], document["shots"][-1]
    wanted = planned().shots[0].shot.trs_from_cam_nominal
    pose = [first["trs_from_cam_nominal"][key] for key in ("qx", "qy", "qz", "qw")]
    assert (Rotation.from_quat(pose).inv() * wanted.rotation).magnitude() < 1e-12
    assert first["nearest_trs_from_cam"]["z_m"] == pytest.approx(3.96)
    assert last["clearance_m"] is None
    assert last["axes_rad"] is None
    assert last["findings"][0] == {
        "check": "reach",
        "is_refusal": True,
        "text": OUT_OF_REACH.text,
    }


def test_csv_has_one_line_a_shot_with_units_in_its_names():
    rows = list(csv.DictReader(io.StringIO(to_csv(shots_table(planned().shots)))))
    assert [row["shot_id"] for row in rows] == list("123456")
    assert float(rows[0]["usable_pct"]) == pytest.approx(12.0)
    assert float(rows[2]["tmac_angle_deg"]) == pytest.approx(np.degrees(0.4))
    assert [row["state"] for row in rows] == ["refused", "warned", "ok", "ok", "ok", "refused"]
    assert not rows[-1]["clearance_m"]


def test_a_plan_replaces_an_earlier_one_whole_or_not_at_all(tmp_path, monkeypatch):
    figures = tmp_path / "figures"
    figures.mkdir()
    earlier = [tmp_path / "plan.json", tmp_path / "index.html", figures / "cell.png"]
    for path in (*earlier, figures / "mine.png"):
        path.write_text("earlier")
    assert check_plan_folder(tmp_path), "it has an earlier plan"

    def full_disk(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("tronlab.report.plan.render_template", full_disk)
        with pytest.raises(ConfigError, match="cannot be written: No space left on device"):
            build_plan_report(report(), tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted([*earlier[:2], figures])
    assert {path.read_text() for path in earlier} == {"earlier"}

    page = build_plan_report(report(), tmp_path)
    names = {path.name for path in figures.iterdir()}
    assert names == {"time.png", "time.pdf", "mine.png"}, "its pictures are gone, nobody else's"
    assert page.read_text().count("data:image/") == 1


def test_a_folder_of_others_is_left_alone(tmp_path):
    (tmp_path / "dataset.h5").write_bytes(b"precious")
    with pytest.raises(ConfigError, match="holds other files than a plan's"):
        build_plan_report(report(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["dataset.h5"]


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "out").touch()
    with pytest.raises(ConfigError, match="is a file"):
        check_plan_folder(tmp_path / "out")
    with pytest.raises(ConfigError, match="no folder that can be written to"):
        check_plan_folder(tmp_path / "out" / "deeper")


def test_pictures_are_drawn_of_plans_with_nothing_to_draw():
    stage, shots = small_stage(), planned().shots
    for few in (shots[2:3], shots[-1:] * 30):
        assert perspective_picture(stage, few).axes
    assert len(shot_charts(replace(planned(), shots=shots[-1:]), stage.context).axes) == 8


def test_elevations_have_one_true_scale():
    """A metre is as long along both axes of both panels."""
    figure = elevation_pictures(small_stage(), planned().shots)
    figure.draw_without_rendering()
    scales = []
    for axes in figure.axes:
        origin, right, up = axes.transData.transform([[0, 0], [1, 0], [0, 1]])
        scales += [right[0] - origin[0], up[1] - origin[1]]
    assert scales == pytest.approx([scales[0]] * 4, rel=0.02)
    assert scales[0] == pytest.approx(scales[1], rel=1e-6)


def test_storyboard_has_an_even_choice_and_the_refused_ones_up_to_a_limit():
    refused, good = planned().shots[0], planned().shots[2]
    some = [replace(good, shot=replace(good.shot, shot_id=i)) for i in range(1, 301)]
    bad = {7, 8, 150}
    shots = [replace(shot, findings=refused.findings) if i in bad else shot
             for i, shot in enumerate(some, start=1)]  # fmt: skip
    chosen = [shot.shot.shot_id for shot in story_shots(shots)]
    assert len(chosen) == len(set(chosen))
    assert chosen == sorted(chosen)
    assert bad <= set(chosen)
    assert {1, 300} <= set(chosen)
    assert N_EVEN <= len(chosen) <= N_EVEN + len(bad)
    all_bad = [replace(shot, findings=refused.findings) for shot in some]
    assert len(story_shots(all_bad)) == N_EVEN + MOST_REFUSED
    assert story_shots(shots[:5]) == tuple(shots[:5])


def test_predicted_views_show_the_model_where_its_outline_is():
    stage = small_stage()
    far = predict_views(planned().shots[:1], stage.context)[0]
    assert far.radiance.shape == CAMERA.shape, "a small camera is not enlarged"
    seen = far.radiance > 0
    assert 0.1 < far.mask.mean() < 0.9
    assert np.mean(seen == far.mask) > 0.9
    wide = replace(stage.context, camera=CAMERA.scaled(640))
    view = predict_views(planned().shots[:1], wide)[0]
    assert view.radiance.shape == (135, 180)
    assert view.mask.mean() == pytest.approx(far.mask.mean(), abs=0.03)


@settings(max_examples=20, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-5, 5)] * 3),
)
def test_a_capsule_is_its_radius_around_its_axis_wherever_it_is(turn, shift):
    pose = RigidTransform.from_components(shift, Rotation.from_rotvec(turn))
    p0, p1 = pose.apply([[0.0, 0.0, 0.0], [0.0, 0.0, 0.7]])
    local = pose.inv().apply(capsule(p0, p1, 0.2, colour="red").points_trs_m.reshape(-1, 3))
    beyond = local[:, 2] - np.clip(local[:, 2], 0.0, 0.7)
    assert np.hypot(np.hypot(local[:, 0], local[:, 1]), beyond) == pytest.approx(0.2)
    assert local[:, 2].min() == pytest.approx(-0.2)
    assert local[:, 2].max() == pytest.approx(0.9)


def test_faces_of_a_box_have_its_area_and_edges_its_length():
    faces, edges = box(box_corners((0, 0, 0), (1.0, 2.0, 0.5)), colour="red")
    diagonals = faces.points_trs_m[:, [2, 3]] - faces.points_trs_m[:, [0, 1]]
    area = 0.5 * np.linalg.norm(np.cross(diagonals[:, 0], diagonals[:, 1]), axis=1).sum()
    assert area == pytest.approx(2 * (2.0 + 1.0 + 0.5))
    length = np.linalg.norm(np.diff(edges.points_trs_m, axis=1), axis=2).sum()
    assert length == pytest.approx(4 * 3.5)


def test_drawn_terrain_has_the_place_and_size_of_the_model():
    stage = small_stage()
    faces = terrain(stage.context.heightmap, stage.context.lamp.p_trs_m)
    points = faces.points_trs_m.reshape(-1, 3)
    assert points[:, :2].min(axis=0) == pytest.approx([0.0, 0.0])
    assert points[:, :2].max(axis=0) == pytest.approx([2.2, 4.2])
    assert ((faces.colours >= 0) & (faces.colours <= 1)).all()


@settings(max_examples=20, deadline=None)
@given(eye=st.tuples(*[st.floats(2, 9)] * 3))
def test_perspective_keeps_what_it_looks_at_in_the_middle_and_up_upright(eye):
    target = np.array([0.5, -0.2, 0.1])
    view = View.from_eye(np.array(eye), target, np.array([0.0, 0.0, 1.0]))
    places, near = view.project(
        np.stack([target, target + np.array([0, 0, 0.5]), 0.5 * (target + eye)])
    )
    assert places[0] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert places[1, 0] == pytest.approx(0.0, abs=1e-9)
    assert places[1, 1] > 0
    assert near[2] > near[0], "half way to the target is nearer"
    basis = np.stack([view.right_trs, view.up_trs, view.towards_trs])
    assert basis @ basis.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(basis) == pytest.approx(1.0)


def test_what_is_nearer_is_drawn_over_what_is_farther():
    x, y, z = np.eye(3)
    view = View(right_trs=x, up_trs=y, towards_trs=z)
    axes = new_figure(2, 2).add_subplot()
    ways = [
        line(np.array([[0, 0, h], [0.1, 0, h]]), colour="red", width=h) for h in (3.0, 1.0, 2.0)
    ]
    draw_faces(axes, view, ways)
    assert axes.collections[0].get_linewidths() == pytest.approx([1.0, 2.0, 3.0])
