"""Keys on disk: this host's own CURVE pair, and the public keys of the hosts it lets in.

::

    ~/.config/palp/keys/            mode 0700; or $PALP_KEYS, or $XDG_CONFIG_HOME/palp/keys
        laptop.secret               mode 0600: the own pair, never shown, never copied
        laptop.public               for the other host: `palp keys allow laptop.public`
        allowed/rig.public          who is let in, one file each

Files are certificates as other ZeroMQ software writes and reads them (``zmq.auth.load_certificate``); a key
is Z85 text of 40 characters.
"""

import contextlib
import os
import re
import shlex
import stat
from pathlib import Path

import msgspec
import zmq

from palp_core.errors import SecurityError
from palp_core.user_folders import keys_folder
from palp_core.whole_file import check_regular, locked_path, write_whole

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}")
_KEY = re.compile(r"[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}")
_FIELD = re.compile(r"""^\s*([\w-]+)\s*=\s*["']([^"'\n]*)["']\s*$""", re.MULTILINE)
_LARGEST_BYTES = 4096


class OwnKeys(msgspec.Struct, frozen=True):
    """This host's pair; ``secret`` is for sockets, never for people."""

    name: str
    public: str
    secret: str

    def __repr__(self) -> str:
        return f"OwnKeys(name={self.name!r}, public={self.public!r})"


def is_key(text: str) -> bool:
    return _KEY.fullmatch(text) is not None


class KeyFolder:
    """The folder of keys of a user on a host; by default from the environment."""

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or keys_folder()

    # The own pair

    def own(self) -> OwnKeys | None:
        """Return the own pair, or None if none was made."""
        secrets = sorted(self.path.glob("*.secret")) if self.path.is_dir() else []
        if not secrets:
            return None
        if len(secrets) > 1:
            names = ", ".join(file.name for file in secrets)
            raise SecurityError(f"{self.path} has several secrets ({names}); keep one, remove the others")
        (file,) = secrets
        for place in (self.path, file):
            _refuse_if_exposed(place)
        fields = _fields(_text(file))
        public, secret = fields.get("public-key", ""), fields.get("secret-key", "")
        if not (is_key(public) and is_key(secret)) or zmq.curve_public(secret.encode()).decode() != public:
            raise SecurityError(f"{file} does not hold a key pair; make another: palp keys generate --force")
        return OwnKeys(file.stem, public, secret)

    def generate(self, name: str, *, force: bool = False) -> OwnKeys:
        _check_name(name)
        self._make_folder(self.path)
        with locked_path(self.path):
            found = sorted(self.path.glob("*.secret"))
            if found and not force:
                raise SecurityError(
                    f"{found[0]} is there already, and other hosts may allow its public key; replace it: "
                    "palp keys generate --force"
                )
            public, secret = _new_pair()
            for old in found:
                old.unlink()
                old.with_suffix(".public").unlink(missing_ok=True)
            write_whole(self.path / f"{name}.secret", _certificate(name, public, secret), mode=0o600)
            write_whole(self.path / f"{name}.public", _certificate(name, public), mode=0o644)
        return OwnKeys(name, public, secret)

    def public_file(self, own: OwnKeys) -> Path:
        return self.path / f"{own.name}.public"

    # Who is let in

    def allowed(self) -> dict[str, str]:
        """Return the allowed public keys by name, as they are on disk now."""
        return {name: key for name, key in self._read_allowed().items() if key}

    def spoiled(self) -> list[str]:
        """Return the names of allowed hosts whose file holds no key: they are not let in."""
        return [name for name, key in self._read_allowed().items() if not key]

    def _read_allowed(self) -> dict[str, str]:
        try:
            return {file.stem: _public(file) for file in sorted((self.path / "allowed").glob("*.public"))}
        except OSError:
            return {}

    def name_of(self, public: str) -> str:
        """Return the name under which a key is allowed; "" if it is not."""
        return next((name for name, key in self.allowed().items() if key == public), "")

    def allow(self, what: str, name: str | None = None) -> tuple[str, str]:
        """Let the owner of a public key in, given by the key or a file that holds it; return name and key.

        By default it is called by the name in the file.
        """
        key, named = self._read_public(what)
        name = name or named
        if not name:
            raise SecurityError("the key needs a name: palp keys allow KEY --name NAME")
        _check_name(name)
        folder = self.path / "allowed"
        self._make_folder(self.path)
        self._make_folder(folder)
        with locked_path(folder):
            if self.allowed().get(name, key) != key:
                raise SecurityError(
                    f"another key is allowed as '{name}'; choose another --name, or first: "
                    f"palp keys deny {name}"
                )
            if (other := self.name_of(key)) not in ("", name):
                raise SecurityError(f"this key is allowed already, as '{other}'")
            write_whole(folder / f"{name}.public", _certificate(name, key), mode=0o644)
        return name, key

    def deny(self, what: str) -> tuple[str, str]:
        """Let a host in no longer, given by its name, its public key or a file that holds it."""
        allowed = self.allowed()
        name = what if what in allowed else ""
        if not name and (is_key(what) or Path(what).is_file()):
            name = self.name_of(self._read_public(what)[0])
        if not name:
            known = ", ".join(allowed) or "no host"
            raise SecurityError(f"'{what}' is not allowed anyway; allowed: {known}")
        (self.path / "allowed" / f"{name}.public").unlink(missing_ok=True)
        return name, allowed[name]

    def find(self, what: str) -> str:
        """Return the public key that a key, a file or the name of an allowed host means."""
        allowed = self.allowed()
        return allowed[what] if what in allowed else self._read_public(what)[0]

    def _read_public(self, what: str) -> tuple[str, str]:
        file = Path(what).expanduser()
        if file.is_file():
            if file.suffix == ".secret":
                raise SecurityError(f"{file} is a secret; keep it here and hand over the .public file")
            text = _text(file)
            fields = _fields(text)
            key = fields.get("public-key", text.strip())
            if not is_key(key):
                raise SecurityError(f"{file} holds no public key; it is made by: palp keys generate")
            return key, fields.get("name") or file.stem
        if is_key(what):
            return what, ""
        known = ", ".join(self.allowed())
        raise SecurityError(
            f"{what!r} is neither a public key (40 characters; quote it in the shell) nor a file"
            + (f" nor the name of an allowed host ({known})" if known else "")
        )

    @staticmethod
    def _make_folder(folder: Path) -> None:
        try:
            if not folder.is_dir():
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                folder.chmod(0o700)
        except OSError as error:
            raise SecurityError(
                f"{folder}: {error.strerror}; set PALP_KEYS to a folder of your own"
            ) from error
        _refuse_if_exposed(folder)


def _check_name(name: str) -> None:
    if NAME.fullmatch(name) is None:
        raise SecurityError(f"'{name}' cannot name a key: letters, digits, '.', '_' and '-', at most 63")


def _refuse_if_exposed(place: Path) -> None:
    found = place.stat()
    if found.st_uid not in (os.getuid(), 0):
        raise SecurityError(f"{place} belongs to another user; make your own: palp keys generate")
    if found.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        mode = "700" if place.is_dir() else "600"
        raise SecurityError(
            f"{place} is open to others (mode {stat.S_IMODE(found.st_mode):03o}); fix it: "
            f"chmod {mode} {shlex.quote(str(place))}"
        )


def _new_pair() -> tuple[str, str]:
    while True:
        public, secret = (key.decode() for key in zmq.curve_keypair())
        if not public.startswith("-"):  # it would read as an option on a command line
            return public, secret


def _certificate(name: str, public: str, secret: str = "") -> str:
    lines = ["metadata", f'    name = "{name}"', "curve", f'    public-key = "{public}"']
    if secret:
        lines.append(f'    secret-key = "{secret}"')
    return "\n".join(lines) + "\n"


def _text(file: Path) -> str:
    try:
        check_regular(file)
        with file.open("rb") as opened:
            return opened.read(_LARGEST_BYTES).decode(errors="replace")
    except OSError as error:
        raise SecurityError(f"{file} cannot be read: {error.strerror}") from error


def _fields(certificate: str) -> dict[str, str]:
    return dict(_FIELD.findall(certificate))


def _public(file: Path) -> str:
    with contextlib.suppress(SecurityError):
        key = _fields(_text(file)).get("public-key", "")
        return key if is_key(key) else ""
    return ""
