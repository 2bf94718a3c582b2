"""What can go wrong, said so that a reader knows what to do."""

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
    grpc.StatusCode.PERMISSION_DENIED,
})

_DETAILS = "grpc-status-details-bin"
"""Trailing metadata in which a server says the parts of an error: a google.rpc.Status."""


class RoundelError(Exception):
    """Any failure of a call or a stream."""

    is_temporary = False
    """Whether asking again later can help."""


class InvalidAddress(RoundelError, ValueError):
    """The address cannot be one."""

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(
            f"{address!r} is no server's address: {reason}; "
            "expected http://HOST:PORT, such as http://127.0.0.1:7670"
        )


class Unreachable(RoundelError):
    """Nobody answers there, or no longer."""

    is_temporary = True

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(
            f"no answer from {address}: {reason}; check the address, and that the server runs "
            "(`roundel serve` or `roundel demo` print theirs)"
        )
        self.reason = reason


class TimedOut(Unreachable, TimeoutError):
    """A call has taken longer than its `timeout_s`. Whether the server has done what was asked is not known."""

    def __init__(self, address: str, call: str, timeout_s: float) -> None:
        super().__init__(address, f"{call} has taken longer than its timeout of {timeout_s:g} s")
        self.timeout_s = timeout_s


class NotRoundel(RoundelError):
    """Somebody answers there, but not a Roundel server that knows the call."""

    def __init__(self, address: str, reason: str, speaks_http2: bool = True) -> None:
        super().__init__(f"{address} answers, but is no Roundel server, or an older one: {reason}")
        self.address = address
        self.reason = reason
        self.speaks_http2 = speaks_http2
        """False of a web server or a proxy: where a Roundel server was before, it may be back soon."""


class Refused(RoundelError):
    """The server refuses the request as it is; asking again will not help."""

    def __init__(self, message: str, code: grpc.StatusCode, field: str | None = None, what: str | None = None) -> None:
        super().__init__(f"the server refuses the request: {message}")
        self.message = message
        self.code = code
        """INVALID_ARGUMENT, NOT_FOUND, OUT_OF_RANGE, FAILED_PRECONDITION or PERMISSION_DENIED."""
        self.field = field
        """The field of the request that is wrong, as the .proto files name it; None where it is none."""
        self.what = what
        """The kind of thing that is not there, such as camera; None but for NOT_FOUND."""


class ServerError(RoundelError):
    """The server cannot answer now; a later try may succeed."""

    is_temporary = True

    def __init__(self, message: str, code: grpc.StatusCode) -> None:
        super().__init__(f"the server cannot answer now ({code.name}): {message}")
        self.message = message
        self.code = code


class Conflict(RoundelError):
    """Somebody else was first: what the request builds on has changed since it was read. Read it again."""

    def __init__(self, message: str, code: grpc.StatusCode) -> None:
        super().__init__(f"somebody else was first: {message}")
        self.message = message
        self.code = code


class Closed(RoundelError):
    """This program has closed the client, or the stream, that it asks."""

    def __init__(self, what: str) -> None:
        super().__init__(f"this {what} has been closed; make another one")


class Stale(RoundelError, TimeoutError):
    """No snapshot is as new as was asked for: who steers by them had better stop."""

    is_temporary = True

    def __init__(self, longest_s: float, age_s: float, link: Link) -> None:
        newest = "none has come yet" if age_s == float("inf") else f"the newest came {age_s:.2f} s ago"
        super().__init__(f"no snapshot within {longest_s:g} s: {newest}; {link}")
        self.age_s = age_s
        """How long ago the newest one came; infinite before the first."""
        self.link = link


def from_rpc(address: str, error: grpc.RpcError, call: str = "the call", timeout_s: float | None = None) -> RoundelError:
    """What a failed call to `address` means."""
    # Both of grpc's kinds of errors have these; their common base declares neither.
    code = error.code() if hasattr(error, "code") else grpc.StatusCode.UNKNOWN
    message = (error.details() if hasattr(error, "details") else None) or str(error)
    if code in _REFUSALS:
        field, what = _refused(error)
        return Refused(message, code, field, what)
    if code is grpc.StatusCode.ABORTED:
        return Conflict(message, code)
    if code is grpc.StatusCode.UNIMPLEMENTED:
        return NotRoundel(address, f"it does not know this call ({message})")
    if code is grpc.StatusCode.DEADLINE_EXCEEDED and timeout_s is not None:
        return TimedOut(address, call, timeout_s)
    if code is grpc.StatusCode.UNAVAILABLE and "Failed parsing HTTP/2" in message:
        return NotRoundel(address, "it speaks no HTTP/2", speaks_http2=False)
    if code is grpc.StatusCode.UNAVAILABLE and _details(error):
        # The network says none.
        return ServerError(message, code)
    if code in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED):
        return Unreachable(address, _network_reason(message))
    return ServerError(message, code)


def _network_reason(message: str) -> str:
    """What grpc says of the network, without the names of its own layers round it."""
    lookup = re.match(r"errors resolving ([^\s:]+)", message)
    if lookup:
        return f"no machine of the name {lookup[1]} is known here"
    return re.sub(r"^failed to connect to all addresses; last error: .*: (.+)$", r"\1", message)


def _refused(error: grpc.RpcError) -> tuple[str | None, str | None]:
    """The wrong field, and the kind of thing that is not there, where the server says them."""
    field: str | None = None
    what: str | None = None
    for value in _details(error):
        try:
            details = status_pb2.Status.FromString(value).details
        except DecodeError:
            # Of another server's making: the sentence says it too.
            continue
        for detail in details:
            request, thing = error_details_pb2.BadRequest(), error_details_pb2.ResourceInfo()
            if detail.Unpack(request) and request.field_violations:
                field = request.field_violations[0].field
            elif detail.Unpack(thing):
                what = thing.resource_type
    return field, what


def _details(error: grpc.RpcError) -> list[bytes]:
    """What a server says of an error for programs; empty if the error comes from the network."""
    trailers: Any = (error.trailing_metadata() if hasattr(error, "trailing_metadata") else None) or ()
    return [value for key, value in trailers if key == _DETAILS]
