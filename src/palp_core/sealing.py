"""A file that nobody reads by accident: packed, behind a line that says what it is.

It is no safe: it keeps from seeing, not from prying.
"""

import base64
import zlib


def sealed(line: bytes, body: bytes, level: int = -1) -> bytes:
    r"""Return content behind a line that says what it is and what opens it.

    >>> opened(b"sealed\n", sealed(b"sealed\n", b"4 mm"))
    b'4 mm'
    """
    return line + base64.encodebytes(zlib.compress(body, level))


def opened(line: bytes, data: bytes) -> bytes:
    """Return the content of :func:`sealed`.

    Raises:
        ValueError: It is damaged.
    """
    try:
        return zlib.decompress(base64.b64decode(data.removeprefix(line)))
    except zlib.error as error:
        raise ValueError(str(error)) from error
