"""How a person names cores."""

import pytest

from tronlab.errors import ScoreError
from tronlab.nav.specs import CoreSpec, parse_core, parse_cores


@pytest.mark.parametrize(
    ("text", "name", "kind", "target"),
    [
        ("akaze", "akaze", "installed", "akaze"),
        ("cmd:./bin/my_core --cfg x=1", "my_core", "command", "./bin/my_core --cfg x=1"),
        ('cmd:"./my core.exe" -v', "fast", "command", '"./my core.exe" -v'),
        ("my_package.core:MyCore", "MyCore", "python", "my_package.core:MyCore"),
        ("tcp://127.0.0.1:5555", "127.0.0.1:5555", "tcp", "127.0.0.1:5555"),
        ("tcp://[::1]:5555/", "::1:5555", "tcp", "[::1]:5555"),
    ],
)
def test_every_way_of_naming_a_core(text: str, name: str, kind: str, target: str) -> None:
    given = text if name != "fast" else f"fast={text}"
    spec = parse_core(given)
    assert (spec.name, spec.kind, spec.target) == (name, kind, target)
    assert parse_core(f"mine={text}") == CoreSpec("mine", spec.kind, target)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cmd:", "no program; write cmd:PROGRAM ARGUMENTS"),
        ('cmd:./core "x', "No closing quotation"),
        ("tcp://host", "write tcp://HOST:PORT"),
        ("tcp://host:70000", "port 1 to 65535"),
        ("cmd:'./my core'", "--core my-name=..."),
        (".hidden", "does not begin with a dot"),
        ("", "cannot be filed under this name"),
    ],
)
def test_what_names_no_core_says_what_would(text: str, message: str) -> None:
    with pytest.raises(ScoreError) as caught:
        parse_core(text)
    assert message in str(caught.value)


def test_two_cores_of_one_name_need_another() -> None:
    assert parse_cores(["akaze", "akaze"]) == (parse_core("akaze"),)
    with pytest.raises(ScoreError, match="name one of them: --core other-name=cmd:b/core"):
        parse_cores(["cmd:a/core", "cmd:b/core"])
    assert len(parse_cores(["cmd:a/core", "b=cmd:b/core"])) == 2
