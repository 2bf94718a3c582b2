"""Errors of calls and streams."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import grpc
from google.protobuf.message import DecodeError
from google.rpc import error_details_pb2, status_pb2

if TYPE_CHECKING:
    from roundel.link import Link

_REFUSALS = frozenset({
    grpc.StatusCode.INVALID_ARGUMENT,
    grpc.StatusCode.NOT_FOUND,
    grpc.StatusCode.OUT_OF_RANGE,
    grpc.StatusCode.FAILED_PRECONDITION,
})

_DETAILS = "grpc-status-details-bin"
"""Trailing metadata with the details of an error, a google.rpc.Status."""


class RoundelError(Exception):
    """Any failure of a call or a stream."""

    is_temporary = False
    """Whether a later retry can succeed."""


class InvalidAddress(RoundelError, ValueError):
    """The address is malformed."""

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(
            f"{address!r} is not a server address: {reason}; "
            "expected http://HOST:PORT or https://HOST:PORT, such as http://127.0.0.1:7670"
        )


class Unreachable(RoundelError):
    """The server does not answer."""

    is_temporary = True

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(
            f"no answer from {address}: {reason}; check the address and that the server is running "
            "(`roundel serve` and `roundel demo` print it)"
        )
        self.reason = reason


class TimedOut(Unreachable, TimeoutError):
    """A call took longer than its `timeout_s`. The server may or may not have executed it."""

    def __init__(self, address: str, call: str, timeout_s: float) -> None:
        super().__init__(address, f"{call} took longer than its timeout of {timeout_s:g} s")
        self.timeout_s = timeout_s


class NotRoundel(RoundelError):
    """The address answers, but not as a Roundel server that knows the call."""

    def __init__(self, address: str, reason: str, speaks_http2: bool = True) -> None:
        super().__init__(f"{address} answers, but is not a Roundel server, or is an older version: {reason}")
        self.address = address
        self.reason = reason
        self.speaks_http2 = speaks_http2
        """False for a web server or a proxy, since a Roundel server behind it may be restarting."""


class Refused(RoundelError):
    """The server rejected the request; a retry will not help."""

    def __init__(self, message: str, code: grpc.StatusCode, field: str | None = None, what: str | None = None) -> None:
        super().__init__(f"the server rejected the request: {message}")
        self.message = message
        self.code = code
        """INVALID_ARGUMENT, NOT_FOUND, OUT_OF_RANGE, FAILED_PRECONDITION, or PERMISSION_DENIED for `PermissionDenied`."""
        self.field = field
        """The invalid field of the request, as named in the .proto files; None for other causes."""
        self.what = what
        """The kind of resource that was not found, such as camera; None for other codes than NOT_FOUND."""


class PermissionDenied(Refused):
    """The role of this client does not include the call."""


class Unauthenticated(RoundelError):
    """The server requires a valid token or client certificate."""

    def __init__(self, message: str) -> None:
        super().__init__(f"the server requires a valid token or client certificate: {message}")
        self.message = message


class Untrusted(RoundelError):
    """The server's certificate does not verify."""

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(
            f"the certificate of {address} is not trusted: {reason}; "
            "name the file of its authority (`ca`), or its `fingerprint`"
        )
        self.reason = reason


class WrongFingerprint(RoundelError):
    """The server's certificate is not the pinned one. It was replaced, or this is another server."""

    def __init__(self, address: str, expected: str, found: str) -> None:
        super().__init__(
            f"{address} has a certificate with the SHA-256 fingerprint {found}, expected {expected}; if the server's "
            "certificate was replaced, use the fingerprint that the server prints at start"
        )
        self.expected = expected
        self.found = found


class ServerError(RoundelError):
    """The server cannot answer now; a later retry may succeed."""

    is_temporary = True

    def __init__(self, message: str, code: grpc.StatusCode) -> None:
        super().__init__(f"the server cannot answer now ({code.name}): {message}")
        self.message = message
        self.code = code


class Conflict(RoundelError):
    """Another client made a change after this one read the state that the request is based on. Read it again."""

    def __init__(self, message: str, code: grpc.StatusCode) -> None:
        super().__init__(f"conflict with another change: {message}")
        self.message = message
        self.code = code


class Closed(RoundelError):
    """This program has closed the client or stream."""

    def __init__(self, what: str) -> None:
        super().__init__(f"this {what} has been closed; create a new one")


class Stale(RoundelError, TimeoutError):
    """No snapshot is recent enough. A control loop should stop."""

    is_temporary = True

    def __init__(self, longest_s: float, age_s: float, link: Link) -> None:
        newest = "none has arrived yet" if age_s == float("inf") else f"the newest arrived {age_s:.2f} s ago"
        super().__init__(f"no snapshot within {longest_s:g} s: {newest}; {link}")
        self.age_s = age_s
        """Time since the newest snapshot arrived; infinite before the first."""
        self.link = link


def from_rpc(address: str, error: grpc.RpcError, call: str = "the call", timeout_s: float | None = None) -> RoundelError:
    """Converts an error of gRPC."""
    # The errors of grpc and grpc.aio have these, but their common base class does not declare them.
    code = error.code() if hasattr(error, "code") else grpc.StatusCode.UNKNOWN
    message = (error.details() if hasattr(error, "details") else None) or str(error)
    if code in _REFUSALS:
        field, what = _refusal_details(error)
        return Refused(message, code, field, what)
    if code is grpc.StatusCode.PERMISSION_DENIED:
        return PermissionDenied(message, code)
    if code is grpc.StatusCode.UNAUTHENTICATED:
        # The first is an error of grpc, not of the server.
        is_other_host = message == "call host does not match SSL server name"
        return Untrusted(address, message) if is_other_host else Unauthenticated(message)
    if code is grpc.StatusCode.ABORTED:
        return Conflict(message, code)
    if code is grpc.StatusCode.UNIMPLEMENTED:
        return NotRoundel(address, f"it does not support this call ({message})")
    if code is grpc.StatusCode.DEADLINE_EXCEEDED and timeout_s is not None:
        return TimedOut(address, call, timeout_s)
    if code is grpc.StatusCode.UNAVAILABLE and "Failed parsing HTTP/2" in message:
        return NotRoundel(address, "it does not speak HTTP/2", speaks_http2=False)
    if code is grpc.StatusCode.UNAVAILABLE and (reason := _distrust(message)):
        return Untrusted(address, reason)
    if code is grpc.StatusCode.UNAVAILABLE and _details(error):
        # Errors of the network have no details.
        return ServerError(message, code)
    if code in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED):
        return Unreachable(address, _network_reason(message))
    return ServerError(message, code)


def _distrust(message: str) -> str | None:
    """Why the server's certificate does not verify, if that is the error."""
    if match := re.search(r"CERTIFICATE_VERIFY_FAILED(?:: ([a-zA-Z' -]+))?", message):
        return match[1] or "it does not verify"
    if match := re.search(r"Peer name \S+ is not in peer certificate|Hostname Verification Check failed", message):
        return f"{match[0]}: the certificate is not for this name or address"
    return None


def _network_reason(message: str) -> str:
    """The cause of a network error, without the names of grpc's internal layers."""
    lookup = re.match(r"errors resolving ([^\s:]+)", message)
    if lookup:
        return f"cannot resolve the host name {lookup[1]}"
    if "TSI_DATA_CORRUPTED" in message:
        return "the server ended the encrypted connection; it may refuse the certificate of this client"
    return re.sub(r"^failed to connect to all addresses; last error: .*: (.+)$", r"\1", message)


def _refusal_details(error: grpc.RpcError) -> tuple[str | None, str | None]:
    """The invalid field and the kind of missing resource, where the server gives them."""
    field: str | None = None
    what: str | None = None
    for value in _details(error):
        try:
            details = status_pb2.Status.FromString(value).details
        except DecodeError:
            # Not a Roundel server. The message suffices.
            continue
        for detail in details:
            request, resource = error_details_pb2.BadRequest(), error_details_pb2.ResourceInfo()
            if detail.Unpack(request) and request.field_violations:
                field = request.field_violations[0].field
            elif detail.Unpack(resource):
                what = resource.resource_type
    return field, what


def _details(error: grpc.RpcError) -> list[bytes]:
    """Machine-readable details from the server; empty for an error of the network."""
    trailers: Any = (error.trailing_metadata() if hasattr(error, "trailing_metadata") else None) or ()
    return [value for key, value in trailers if key == _DETAILS]
