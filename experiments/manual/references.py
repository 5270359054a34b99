"""The documents and methods that the code names: ``docs/references.bib``, and where each is used.

An entry of the bibliography tells how the code names its source (``cited``), such as «Bierman 1977» or «Xi2023». The
files that use it are found by that name, so nobody keeps a list of them. Equations, tables and figures of the five
documents are found in the same way: «Xi2023 eq. 6», «Huang2024 eqs. 9, 12 and 13».
"""

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from ...envs.engine.quantity import InvalidInput
from ..store.markdown import table
from ..store.stamp import ROOT

BIBLIOGRAPHY = ROOT / "docs" / "references.bib"
FOLDERS = ("envs", "baselines", "agents", "experiments", "tests")
ASIDE = ("experiments/manual/", "tests/test_references.py")
"""Files that name sources as examples only."""

DOCUMENTS = "The five documents"
"""Topic of the sources that define the machine; the code names them more often than a page can list."""

NEEDED = ("title", "cited", "topic", "use")
"""Fields that every entry has."""

NAME_YEAR = re.compile(r"(?<!\w)[A-ZÅÄÖÜ][a-zà-ž][\w’'-]*(?: et al\.?)?,? \(?(?:1[6-9]|20)\d\d(?![\d.,]\d|\d)")
"""What looks like the end of a source's name: «Bierman 1977», «Walt 2015», «Boyd et al. (2011)»."""

_FIRST = re.compile(r"@(\w+)\{([\w-]+),")
_FIELD = re.compile(r"  (\w+) = \{(.*)\},")
_PLACE = re.compile(
    r"(?P<document>{})(?:'s|’s)? \(?(?P<kind>eq|Eq|Table|Fig|table|fig)(?:s?\.|s)? ?"
    r"(?P<numbers>\d+(?:(?:–|, | and |, and )\d+)*)"
)
_KINDS = {"eq": "equation", "table": "table", "fig": "figure"}


class Entry(NamedTuple):
    """A source: BibTeX's type and key, and its fields."""

    kind: str
    key: str
    fields: dict[str, str]

    @property
    def cited(self) -> str:
        """How the code names it."""
        return self.fields["cited"]


def entries(text: str | None = None) -> list[Entry]:
    """The bibliography, in its order. It is our own file, so it has one form: a field a line.

    Raises:
        InvalidInput: a line of another form, a field that is missing or twice there, or two sources of one name.
    """
    out: list[Entry] = []
    open_entry: Entry | None = None
    text = BIBLIOGRAPHY.read_text(encoding="utf-8") if text is None else text
    for number, line in enumerate(text.split("\n"), start=1):
        where = f"{BIBLIOGRAPHY.name}, line {number}"
        if open_entry is None and (not line or line.startswith("%")):
            continue
        if open_entry is None and (first := _FIRST.fullmatch(line)):
            open_entry = Entry(first[1], first[2], {})
        elif open_entry is not None and (field := _FIELD.fullmatch(line)):
            if field[1] in open_entry.fields:
                raise InvalidInput(f"{where}: '{field[1]}' stands twice in '{open_entry.key}'")
            if field[2].count("{") != field[2].count("}"):
                raise InvalidInput(f"{where}: braces of '{field[1]}' do not close")
            open_entry.fields[field[1]] = field[2]
        elif open_entry is not None and line == "}":
            missing = [each for each in NEEDED if not open_entry.fields.get(each)]
            if missing:
                raise InvalidInput(f"{where}: '{open_entry.key}' lacks {', '.join(missing)}")
            out.append(open_entry)
            open_entry = None
        else:
            raise InvalidInput(f"{where}: «{line}» is neither '@type{{key,', '  field = {{value}},' nor '}}'")
    if open_entry is not None:
        raise InvalidInput(f"{BIBLIOGRAPHY.name}: '{open_entry.key}' does not end")
    for name in ("key", "cited"):
        values = [getattr(each, name) for each in out]
        if twice := {each for each in values if values.count(each) > 1}:
            raise InvalidInput(f"{BIBLIOGRAPHY.name}: {name} {', '.join(sorted(twice))} stands twice")
    return out


# ------------------------------------------------------------------------------------------------------- in the sources


def sources() -> dict[str, str]:
    """Every module and material by its path in the repository, each as one line, so that a name may wrap."""
    out = {}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            name = path.relative_to(ROOT).as_posix()
            if path.suffix in (".py", ".toml") and not name.startswith(ASIDE):
                out[name] = unwrapped(path.read_text(encoding="utf-8"))
    return out


def unwrapped(text: str) -> str:
    """A source with its lines joined; a comment that goes on in the next line goes on without its sign."""
    return re.sub(r"\s*\n\s*(?:# ?)?", " ", text)


def used(found: Iterable[Entry], texts: dict[str, str]) -> dict[str, list[str]]:
    """The files that name each entry, by its key."""
    out = {}
    for entry in found:
        pattern = re.compile(rf"(?<![\w/-]){re.escape(entry.cited)}(?![\w/])")
        out[entry.key] = [name for name, text in texts.items() if pattern.search(text)]
    return out


def unknown(text: str, found: Iterable[Entry]) -> list[str]:
    """What looks like the name of a source in an unwrapped text and has no entry."""
    for entry in sorted(found, key=lambda each: -len(each.cited)):
        text = text.replace(entry.cited, "…")
    return [each[0] for each in NAME_YEAR.finditer(text)]


def places(found: Iterable[Entry], texts: dict[str, str]) -> dict[tuple[str, str, int], list[str]]:
    """The files that name an equation, table or figure of one of the documents: {(document, kind, number): files}."""
    documents = [each.cited for each in found if each.fields["topic"] == DOCUMENTS]
    pattern = re.compile(_PLACE.pattern.replace("{}", "|".join(documents), 1))
    out: dict[tuple[str, str, int], list[str]] = {}
    for name, text in texts.items():
        for each in () if name.startswith("tests/") else pattern.finditer(text):
            for number in _numbers(each["numbers"]):
                files = out.setdefault((each["document"], _KINDS[each["kind"].lower()], number), [])
                files += [name] if name not in files else []
    order = {document: i for i, document in enumerate(documents)}
    kinds = list(_KINDS.values())
    return dict(sorted(out.items(), key=lambda each: (order[each[0][0]], kinds.index(each[0][1]), each[0][2])))


def _numbers(text: str) -> Iterator[int]:
    """«3–5, 7 and 9» as numbers."""
    for part in re.split(r", and |, | and ", text):
        first, _, last = part.partition("–")
        yield from range(int(first), int(last or first) + 1)


# ------------------------------------------------------------------------------------------------------------- the page


def bibliography() -> str:
    """Every source by topic: what it is, what it is used for, and where."""
    found = entries()
    files = used(found, sources())
    topics: dict[str, list[Entry]] = {}
    for each in found:
        topics.setdefault(each.fields["topic"], []).append(each)
    text = []
    for topic, some in topics.items():
        rows = (
            (each.cited, citation(each), each.fields["use"], _listed(_shown(each, files[each.key])))
            for each in (some if topic == DOCUMENTS else sorted(some, key=lambda entry: entry.cited.casefold()))
        )
        text.append(f"## {topic}\n\n" + table(("in the code", "source", "used for", "where"), rows))
    return "\n\n".join(text)


def documents() -> str:
    """The five documents in full, one an item of a list, with what each is used for."""
    rows = (each for each in entries() if each.fields["topic"] == DOCUMENTS)
    return "\n".join(f"- **{each.cited}**: {citation(each)} *Here: {each.fields['use']}.*" for each in rows) + "\n"


def equations() -> str:
    """Where an equation, table or figure of the five documents is."""
    rows = (
        (document, f"{kind} {number}", _listed(files))
        for (document, kind, number), files in places(entries(), sources()).items()
    )
    return table(("document", "place", "where"), rows)


def citation(entry: Entry) -> str:
    """An entry as a line of Markdown: authors, title, where it was published, address."""
    f = {name: _plain(value) for name, value in entry.fields.items()}
    where = f.get("journal") or f.get("booktitle") or f.get("school") or f.get("institution") or f.get("publisher", "")
    if f.get("publisher") and where != f["publisher"]:
        where += f", {f['publisher']}"
    volume = f.get("volume", "") + (f"({f['number']})" if f.get("volume") and f.get("number") else "")
    where = " ".join(each for each in (where, volume or f.get("number", "")) if each)
    where += f": {f['pages']}" if f.get("pages") else ""
    edition = f"edition {f['edition']}" if "edition" in f else ""
    link = f.get("howpublished", "")
    link = f"[{link.removeprefix('https://')}]({link})" if link.startswith("https://") else link
    doi = f"[doi:{f['doi']}](https://doi.org/{f['doi']})" if "doi" in f else ""
    authors = _authors(f.get("author", ""), 99 if f["topic"] == DOCUMENTS else 4)
    parts = (authors, f"*{f['title']}*", edition, where, link, f.get("year"), doi, f.get("note"))
    return ". ".join(each for each in parts if each) + "."


def _authors(text: str, most: int) -> str:
    names = text.split(" and ") if text else []
    turned = [" ".join(reversed(each.split(", "))) if each != "others" else "others" for each in names]
    if len(turned) > most:
        return f"{', '.join(turned[:3])} and others"
    return " and ".join([", ".join(turned[:-1]), turned[-1]] if len(turned) > 1 else turned)


def _plain(text: str) -> str:
    """A field without LaTeX: formulas, braces, dashes."""
    text = re.sub(r"\$([^$]*)\$", lambda each: each[1].replace("{", "(").replace("}", ")"), text)
    return re.sub(r"[{}]", "", text).replace("\\&", "&").replace("---", "—").replace("--", "–")


def _shown(entry: Entry, files: list[str]) -> list[str]:
    """The files to list: tests only where nothing else names the source, of a document only what is built on it."""
    if entry.fields["topic"] == DOCUMENTS:
        return [each for each in files if each.startswith(("envs/", "baselines/")) and each.endswith(".py")]
    return [each for each in files if not each.startswith("tests/")] or files


def _listed(files: Iterable[str]) -> str:
    return ", ".join(f"[{each.removesuffix('.py')}](../{each})" for each in files)
