"""What can be found wrong with a study before anything of it begins."""

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.config import load_campaign
from tronlab.campaign.job import Files, Job, read_job
from tronlab.campaign.live import Live
from tronlab.campaign.provenance import device_identities
from tronlab.campaign.rig import load_rig
from tronlab.devices.registry import connected
from tronlab.errors import ConfigError, ScoreError
from tronlab.nav.cores import BUILT_IN_CORES, is_built_in
from tronlab.nav.settings import core_settings
from tronlab.nav.specs import parse_core
from tronlab.study.recording import recording_of
from tronlab.study.study import Study
from tronlab.study.variants import Variant, write_variant
from tronlab.yaml_models import Location, join_errors


def check_study(study: Study, *, live: Live) -> None:
    """Read everything a study names, and find every contradiction that needs no device.

    Args:
        study: The study.
        live: Shows how far it is: trajectories that are computed take a while.

    Raises:
        ConfigError: A file says something that cannot be; one line for each mistake.
        CalibrationError: A calibration record cannot serve.
        PlanError: A campaign has no shots.
    """
    with TemporaryDirectory(prefix="tronlab-study-") as folder:
        variants = Path(folder)
        errors = [*_wrong_cores(study), *_wrong_settings(study), *_wrong_rigs(study)]
        errors += _wrong_variants(study, variants)
        if errors:
            raise join_errors(errors)
        _check_campaigns(study, variants, live)
        _check_photometry(study, live)


def _check_campaigns(study: Study, folder: Path, live: Live) -> None:
    """Read the campaigns with the records that are kept, trajectories and all."""
    for n_done, dataset in enumerate(study.datasets, start=1):
        recording = recording_of(study, dataset)
        campaign = write_variant(folder / recording.slug, recording.campaign)
        record = study.laboratory(dataset).record
        # A full study makes a record of its own: that this one has expired is no hindrance.
        acceptance = Acceptance(not study.quick, warn=live.announce)
        files = Files(campaign, recording.rig.extends, record)
        job = read_job(files, seed=None, acceptance=acceptance)
        if study.quick:
            _check_devices(job)
        live.advance("campaigns read", n_done=n_done, n_all=len(study.datasets))


def _check_photometry(study: Study, live: Live) -> None:
    """Read the campaigns that a full study measures photometry with."""
    for name in () if study.quick else study.laboratories:
        one = study.config.laboratories[name]
        if one.photometry is not None:
            acceptance = Acceptance(is_given=True, warn=live.announce)
            read_job(Files(one.photometry, one.rig, one.record), seed=None, acceptance=acceptance)


def _check_devices(job: Job) -> None:
    """See that the record kept is of the rig as it is now, not after minutes of recording."""
    devices = job.rig.open_devices(job.seed)
    with connected(devices):
        job.calibration.check_devices(device_identities(devices))


def _wrong_rigs(study: Study) -> Iterator[ConfigError]:
    """Find rigs that cannot be read, and larger terrains that are missing or have no record."""
    for dataset in study.datasets:
        try:
            rig = load_rig(study.rig_file(dataset))
            if dataset not in study.larger:
                continue
            larger = load_rig(study.rig_file(dataset, larger=True))
        except ConfigError as error:
            yield error
            continue
        if larger.name != rig.name and study.laboratory(dataset).larger_record is None:
            yield study.error(
                f"rig {larger.name!r} needs a calibration record of its own, that of {rig.name!r}"
                " is another rig's; make it: tronlab calibrate all --rig RIG.yaml",
                "laboratories",
                study.laboratory_name(dataset),
                "larger_record",
            )


def _wrong_cores(study: Study) -> Iterator[ConfigError]:
    lists: list[tuple[tuple[str, ...], Location]] = [
        (study.config.cores, ("cores",)),
        (study.load.cores, ("quick", "load", "cores") if study.quick else ("load", "cores")),
    ]
    for cores, location in lists:
        for i, text in enumerate(cores):
            try:
                is_built_in(parse_core(text))
            except ScoreError as error:
                yield study.error(str(error), *location, i)


def _wrong_settings(study: Study) -> Iterator[ConfigError]:
    """Find ways of choosing features and matches that no core has."""
    for name, variant in study.selection.items():
        location = ("selection", "variants", name)
        if variant.base not in BUILT_IN_CORES:
            known = ", ".join(BUILT_IN_CORES)
            yield study.error(
                f"no core {variant.base!r} whose settings can be changed; there are: {known}",
                *location,
                "base",
            )
            continue
        try:
            settings = core_settings(variant.base, variant.settings)
        except ConfigError as error:
            inner = f"settings of {variant.base}"
            yield from (
                _told_of(study, part, (*location, "settings"), inner) for part in error.parts
            )
            continue
        is_by_scores = variant.prune_to is not None and variant.prune_by == "scores"
        if is_by_scores and settings.detector != core_settings(variant.base, {}).detector:
            yield study.error(
                f"scores of {variant.base} choose among the landmarks of its own detector; leave"
                " the detector as it is, or take another prune_by",
                *location,
                "settings",
                "detector",
            )


def _wrong_variants(study: Study, folder: Path) -> Iterator[ConfigError]:
    """Find changes that no rig or campaign file could have."""
    rigs = {study.rig_file(dataset) for dataset in study.ablation_every_n}
    campaigns = {study.campaign_file(dataset) for dataset in study.ablation_every_n}
    # All of them: the variant without any source has all changes, in a quick study too.
    for name, source in study.config.ablation.sources.items():
        location = ("ablation", "sources", name)
        for extended in sorted(rigs):
            yield from _wrong_changes(
                study, Variant(extended, source.rig), (*location, "rig"), folder, load_rig
            )
        for extended in sorted(campaigns):
            yield from _wrong_changes(
                study,
                Variant(extended, source.campaign),
                (*location, "campaign"),
                folder,
                load_campaign,
            )


def _wrong_changes(
    study: Study,
    variant: Variant,
    location: Location,
    folder: Path,
    load: Callable[[Path], object],
) -> Iterator[ConfigError]:
    """Write a variant for a try; give what is wrong with it, where the study file has it."""
    path = write_variant(folder / "variant.yaml", variant)
    try:
        load(path)
    except ConfigError as error:
        for part in error.parts:
            is_ours = part.path == path
            yield _told_of(study, part, location, "changes") if is_ours else part


def _told_of(study: Study, error: ConfigError, location: Location, inner: str) -> ConfigError:
    """Say where in the study file a mistake is that was found elsewhere.

    Args:
        study: The study.
        error: What was found.
        location: Where the study file has the values.
        inner: What the error calls their top.
    """
    key = error.key or inner
    message = str(error).partition(f"{key}: ")[2] or str(error)
    below = key.removeprefix(inner).lstrip(".")
    return study.error(message, *location, *(below.split(".") if below else ()))
