"""How many of something, in words."""


def counted(number: int, thing: str, more: str = "") -> str:
    """Return a number and what there is so many of.

    Args:
        number: How many.
        thing: What one is called.
        more: What several are called, if not as usual.

    >>> counted(1, "gap"), counted(0, "gap"), counted(2, "is", "are")
    ('1 gap', '0 gaps', '2 are')
    """
    return f"{number} {thing if number == 1 else more or f'{thing}s'}"
