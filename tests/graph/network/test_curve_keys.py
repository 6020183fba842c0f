"""Keys on disk: made once, kept secret, handed over by file."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
import zmq.auth
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import SecurityError
from palp_core.graph.network.keys import KeyFolder, is_key


@pytest.fixture
def keys(tmp_path: Path) -> KeyFolder:
    return KeyFolder(tmp_path / "deep" / "keys")


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_pair_is_made_once_with_the_secret_for_its_owner_only(keys: KeyFolder) -> None:
    assert keys.own() is None
    before = os.umask(0)
    try:
        made = keys.generate("laptop")
    finally:
        os.umask(before)
    assert keys.own() == made
    certificate = zmq.auth.load_certificate(keys.path / "laptop.secret")  # as other ZeroMQ software does
    assert certificate == (made.public.encode(), made.secret.encode())
    assert mode(keys.path) == 0o700
    assert mode(keys.path / "laptop.secret") == 0o600
    assert mode(keys.path / "laptop.public") == 0o644
    assert made.secret not in keys.public_file(made).read_text()
    assert made.secret not in repr(made)
    with pytest.raises(SecurityError, match="--force"):
        keys.generate("laptop")
    assert keys.generate("rig", force=True).public != made.public
    assert [file.name for file in sorted(keys.path.iterdir())] == ["rig.public", "rig.secret"]


@pytest.mark.parametrize("loose", [0o640, 0o604, 0o644, 0o660])
def test_an_exposed_secret_is_refused_with_the_command_that_mends_it(keys: KeyFolder, loose: int) -> None:
    keys.generate("laptop")
    secret = keys.path / "laptop.secret"
    secret.chmod(loose)
    with pytest.raises(SecurityError, match=f"chmod 600 {secret}"):
        keys.own()
    secret.chmod(0o600)
    keys.path.chmod(0o755)
    with pytest.raises(SecurityError, match=f"chmod 700 {keys.path}"):
        keys.own()


def test_a_secret_that_is_torn_of_another_pair_or_one_of_two_is_refused(
    keys: KeyFolder, tmp_path: Path
) -> None:
    mine, other = keys.generate("laptop"), KeyFolder(tmp_path / "other").generate("other")
    secret = keys.path / "laptop.secret"
    sound = secret.read_text()
    for spoiled in (sound[:-10], sound.replace(mine.public, other.public)):
        secret.write_text(spoiled)
        with pytest.raises(SecurityError, match="does not hold a key pair"):
            keys.own()
    (keys.path / "other.secret").touch(0o600)
    with pytest.raises(SecurityError, match="several secrets"):
        keys.own()


def test_hosts_are_allowed_by_file_or_key_and_denied_by_name_or_key(keys: KeyFolder, tmp_path: Path) -> None:
    folder = KeyFolder(tmp_path / "other")
    other = folder.generate("laptop")
    assert keys.allow(str(folder.public_file(other))) == ("laptop", other.public)
    assert keys.allowed() == {"laptop": other.public}
    assert keys.name_of(other.public) == "laptop"
    assert keys.find("laptop") == keys.find(other.public) == other.public
    assert keys.deny(other.public) == ("laptop", other.public)
    assert keys.allowed() == {}
    assert keys.allow(other.public, "guest") == ("guest", other.public)
    with pytest.raises(SecurityError, match="allowed already, as 'guest'"):
        keys.allow(other.public, "again")
    with pytest.raises(SecurityError, match="another key is allowed as 'guest'"):
        keys.allow(KeyFolder(tmp_path / "third").generate("third").public, "guest")
    assert keys.deny("guest")[1] == other.public
    with pytest.raises(SecurityError, match="not allowed anyway"):
        keys.deny("guest")


def test_a_secret_is_not_taken_for_a_public_key(keys: KeyFolder, tmp_path: Path) -> None:
    folder = KeyFolder(tmp_path / "other")
    folder.generate("laptop")
    with pytest.raises(SecurityError, match="is a secret"):
        keys.allow(str(folder.path / "laptop.secret"))
    with pytest.raises(SecurityError, match="--name"):
        keys.allow("k" * 40)
    with pytest.raises(SecurityError, match="neither a public key"):
        keys.allow("k" * 39)


@settings(max_examples=30)
@given(st.text(max_size=70))
def test_no_name_leads_out_of_the_folder(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    keys = KeyFolder(tmp_path_factory.mktemp("k") / "keys")
    try:
        keys.allow("k" * 40, name or "x")
    except SecurityError:
        return
    (file,) = (keys.path / "allowed").iterdir()
    assert file.name == f"{name or 'x'}.public"
    assert "/" not in name


@pytest.mark.parametrize(
    "content", [bytes(range(256)), b"public-key of the laptop", b"public-key", b"curve\n    secret-key"]
)
def test_a_file_without_a_key_lets_nobody_in_and_is_named(
    keys: KeyFolder, tmp_path: Path, content: bytes
) -> None:
    keys.allow(KeyFolder(tmp_path / "other").generate("laptop").public, "laptop")
    (keys.path / "allowed" / "laptop.public").write_bytes(content)
    assert keys.allowed() == {}
    assert keys.spoiled() == ["laptop"]
    (tmp_path / "letter.txt").write_bytes(content)
    with pytest.raises(SecurityError, match="holds no public key"):
        keys.allow(str(tmp_path / "letter.txt"))


@settings(max_examples=50)
@given(st.text(max_size=50))
def test_only_forty_characters_of_z85_have_the_form_of_a_key(text: str) -> None:
    assert not is_key(text) or (len(text) == 40 and text.isascii() and "'" not in text and "\\" not in text)
