"""Server addresses."""

from __future__ import annotations

from urllib.parse import urlsplit

from roundel.errors import InvalidAddress


def target(address: str) -> str:
    """HOST:PORT of `http://HOST:PORT`; the scheme is optional."""
    text = address.strip().rstrip("/")
    if not text:
        raise InvalidAddress(address, "it is empty")
    if "://" not in text:
        text = f"http://{text}"
    scheme = text.split("://", 1)[0]
    if scheme == "https":
        raise InvalidAddress(address, "neither this client nor the server supports TLS")
    if scheme != "http":
        raise InvalidAddress(address, f"{scheme}:// is not http://")
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError as error:
        raise InvalidAddress(address, str(error)) from None
    if parts.path or parts.query or parts.fragment:
        raise InvalidAddress(address, f"unexpected {parts.path or parts.query or parts.fragment} after the port")
    if not parts.hostname or any(letter.isspace() for letter in parts.netloc):
        raise InvalidAddress(address, "the host is missing or contains a space")
    if port is None:
        raise InvalidAddress(address, "the port is missing")
    return parts.netloc
