"""What can go wrong, said so that a reader knows what to do."""

from __future__ import annotations

import grpc

_REFUSALS = frozenset({
    grpc.StatusCode.INVALID_ARGUMENT,
    grpc.StatusCode.NOT_FOUND,
    grpc.StatusCode.OUT_OF_RANGE,
    grpc.StatusCode.FAILED_PRECONDITION,
})


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


class NotRoundel(RoundelError):
    """Somebody answers there, but not a Roundel server that knows the call."""

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(f"{address} answers, but is no Roundel server, or an older one: {reason}")


class Refused(RoundelError):
    """The server refuses the request as it is; asking again will not help."""

    def __init__(self, message: str, code: grpc.StatusCode) -> None:
        super().__init__(f"the server refuses the request: {message}")
        self.message = message
        self.code = code


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


def from_rpc(address: str, error: grpc.RpcError) -> RoundelError:
    """What a failed call to `address` means."""
    # Both of grpc's kinds of errors have these; their common base declares neither.
    code = error.code() if hasattr(error, "code") else grpc.StatusCode.UNKNOWN
    message = (error.details() if hasattr(error, "details") else None) or str(error)
    if code in _REFUSALS:
        return Refused(message, code)
    if code is grpc.StatusCode.ABORTED:
        return Conflict(message, code)
    if code is grpc.StatusCode.UNIMPLEMENTED:
        return NotRoundel(address, f"it does not know this call ({message})")
    if code in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED):
        return Unreachable(address, message)
    return ServerError(message, code)
