"""The seal on a truth: a salted SHA-256, published before the engine runs, checked before it is scored."""

from __future__ import annotations

import hashlib
import json
import secrets
from dataclasses import dataclass
from typing import Any


class BrokenSeal(ValueError):
    """The truth is not the one that was sealed."""


@dataclass(frozen=True)
class Sealed:
    """A truth and its salt; only ``digest`` is published before the engine has answered."""

    truth: dict[str, Any]
    salt: str

    @property
    def digest(self) -> str:
        """sha256 over the salt and the truth's canonical JSON."""
        return hashlib.sha256(f"{self.salt}\n{canonical(self.truth)}".encode()).hexdigest()


def seal(truth: dict[str, Any]) -> Sealed:
    """Seal a truth with a salt of 32 random bytes, so that nobody can try truths against the digest."""
    return Sealed(truth, secrets.token_hex(32))


def check(sealed: Sealed, published: str) -> dict[str, Any]:
    """The truth, if it is the one whose digest was published.

    Raises:
        BrokenSeal: it is not.
    """
    if not secrets.compare_digest(sealed.digest, published):
        raise BrokenSeal(f"case {sealed.truth.get('case')}: the truth does not match its seal {published[:12]}")
    return sealed.truth


def canonical(truth: dict[str, Any]) -> str:
    """JSON with sorted keys, no spaces, no NaN: the same truth gives the same text."""
    return json.dumps(truth, sort_keys=True, separators=(",", ":"), allow_nan=False)
