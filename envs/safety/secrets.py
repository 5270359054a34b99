"""Secrets in text that is stored or shown: the passwords of URLs."""

import re
from typing import Any

HIDDEN = "…"

_SCHEME = r"(?<![\w+.\-])(?:(?![A-Za-z])[\w+.\-])*+[A-Za-z][\w+.\-]*+://"
"""From the first of all characters that a scheme may have, and never back: a long word is read once, not from each of
its characters anew."""

_PASSWORD = re.compile(rf"(?P<before>{_SCHEME}[^\s:/@?#'\"]*:)[^\s'\"]*(?=@)")
"""Up to the last @: a password with one of its own must not be half shown."""

_WORD = re.compile(rf"(?P<before>{_SCHEME}[^\s:/@?#]*:).*(?=@)", re.DOTALL)

_QUERY = re.compile(
    r"(?P<before>[?&][\w.\-]*(?:pass(?:word|wd|phrase|file)?|pwd|secret|token|key|auth|credential)[\w.\-]*=)[^\s&#'\"]*",
    re.IGNORECASE,
)


def masked(text: str) -> str:
    """The text with … in place of every password in a URL, as ``user:password@host`` or ``?password=``."""
    return _QUERY.sub(rf"\g<before>{HIDDEN}", _PASSWORD.sub(rf"\g<before>{HIDDEN}", text))


def masked_word(word: str) -> str:
    """The same of one word of a command, whose password may have blanks and quotes."""
    return masked(_WORD.sub(rf"\g<before>{HIDDEN}", word))


def without(text: str, url: str) -> str:
    """The same, also without the password of ``url`` where it stands by itself, as in what a driver says."""
    for pattern in (_WORD, _QUERY):
        for found in pattern.finditer(url):
            secret = found[0][len(found["before"]) :]
            if secret and secret != HIDDEN:
                text = text.replace(secret, HIDDEN)
    return masked(text)


def everywhere(data: Any) -> Any:
    """The same of every text in tables and lists."""
    if isinstance(data, dict):
        return {key: everywhere(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return type(data)(everywhere(value) for value in data)
    return masked(data) if isinstance(data, str) else data
