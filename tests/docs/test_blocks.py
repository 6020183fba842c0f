"""Each command of the documentation works and prints what the page shows."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.site.made_pages import MADE, whole_page
from tests.docs.pages import RUN, Reader, blocks
from tests.support.palp import ROOT, Palp

PAGES = sorted(
    str(page.relative_to(ROOT))
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/**/*.md"))
)
QUICK, BEGIN, END = "docs/tutorial/first_node.md", "## Two nodes", "A program can run"
"""The page of which a part is tried with every change, between these words; all have their turn at night."""


def text_of(page: str) -> str:
    return whole_page(page) if page in MADE else (ROOT / page).read_text(encoding="utf-8")


def has_something_to_run(page: str) -> bool:
    return any(block.language in RUN and not block.why_not for block in blocks(text_of(page)))


def test_each_block_is_run_or_says_why_not() -> None:
    for page in PAGES:
        text = text_of(page)
        comments = text.count("<!-- not run") + text.count("<!-- background")
        found = list(blocks(text))
        assert comments == sum(bool(block.why_not or block.background) for block in found), (
            f"{page}: no block"
        )
        for block in found:
            where = f"{page}:{block.line}"
            assert block.language, f"{where}: which language is it? text, if it is none"
            if block.language == "yaml" and not block.why_not:
                assert block.file, f"{where}: begin it with '# name.yaml', or give a reason to skip it"


def read_whole(text: str, page: str, folder: Path, palp: Palp) -> None:
    Reader(text, page, folder / "place", palp).read()
    assert palp.all_gone(within_s=60)


def test_what_a_part_of_a_page_says_works(palp: Palp, tmp_path: Path) -> None:
    text = text_of(QUICK)
    read_whole(text[text.index(BEGIN) : text.index(END)], QUICK, tmp_path, palp)


@pytest.mark.nightly
@pytest.mark.parametrize("page", [*(page for page in PAGES if has_something_to_run(page)), *MADE])
def test_what_a_page_says_works(page: str, palp: Palp, tmp_path: Path) -> None:
    read_whole(text_of(page), page, tmp_path, palp)


SAMPLE = """
<!-- not run: needs a rig -->
```sh
false
```

```yaml
# some.yaml
a: 1
```

```sh
cat some.yaml
echo 3.14 done
```

<!-- numbers differ -->
```output
a: 2
2.71   ...ne
```
"""


def test_a_reader_types_what_stands_there_and_compares_what_he_sees(palp: Palp, tmp_path: Path) -> None:
    read_whole(SAMPLE, "docs/tutorial/sample", tmp_path, palp)


@pytest.mark.parametrize(
    ("was", "becomes", "complaint"),
    [
        ("<!-- not run: needs a rig -->\n", "", "sample:2: status 1"),
        ("...ne", "...undone", "sample:18: not printed: '2.71   ...undone'"),
        ("<!-- numbers differ -->\n", "", "sample:17: not printed: 'a: 2'"),
        ("# some.yaml\n", "", "sample:7: what file is it?"),
    ],
)
def test_a_page_that_is_wrong_is_found(
    was: str, becomes: str, complaint: str, palp: Palp, tmp_path: Path
) -> None:
    with pytest.raises(AssertionError) as raised:
        read_whole(SAMPLE.replace(was, becomes), "docs/tutorial/sample", tmp_path, palp)
    assert complaint in str(raised.value)
