"""Server addresses."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import urlsplit

from roundel.errors import InvalidAddress


@dataclass(frozen=True)
class Address:
    """A parsed address."""

    text: str
    """As given."""
    target: str
    """HOST:PORT."""
    host: str
    port: int
    is_encrypted: bool

    @classmethod
    def parse(cls, address: str) -> Address:
        """Parses `http://HOST:PORT` or `https://HOST:PORT`. Without a scheme it is the former."""
        text = address.strip().rstrip("/")
        if not text:
            raise InvalidAddress(address, "it is empty")
        if "://" not in text:
            text = f"http://{text}"
        scheme = text.split("://", 1)[0]
        if scheme not in ("http", "https"):
            raise InvalidAddress(address, f"{scheme}:// is neither http:// nor https://")
        try:
            parts = urlsplit(text)
            port = parts.port
        except ValueError as error:
            raise InvalidAddress(address, str(error)) from None
        if parts.path or parts.query or parts.fragment:
            unexpected = parts.path or parts.query or parts.fragment
            raise InvalidAddress(address, f"unexpected {unexpected} after the port")
        if not parts.hostname or any(letter.isspace() for letter in parts.netloc):
            raise InvalidAddress(address, "the host is missing or contains a space")
        if port is None:
            raise InvalidAddress(address, "the port is missing")
        return cls(address, parts.netloc, parts.hostname, port, scheme == "https")
