"""Trust in the server and identity of the client: credentials of gRPC channels."""

from __future__ import annotations

import hashlib
import os
import socket
import ssl
from dataclasses import dataclass, field
from typing import Any, Mapping, Union

import grpc

from roundel._address import Address
from roundel._calls import CHANNEL_OPTIONS, CONNECT_TIMEOUT_S
from roundel.errors import Unreachable, Untrusted, WrongFingerprint

PathLike = Union[str, "os.PathLike[str]"]


@dataclass(frozen=True)
class Trust:
    """How to connect to a server. Reads the files of the options when it is made."""

    address: Address
    ca: bytes | None = None
    """Authorities in PEM; None: the system's."""
    fingerprint: str | None = None
    """SHA-256 of the only trusted certificate, in hexadecimal digits."""
    certificate: tuple[bytes, bytes] | None = field(default=None, repr=False)
    """The client's certificate and key in PEM."""
    metadata: tuple[tuple[str, str], ...] = field(default=(), repr=False)
    """Sent with every call."""

    @classmethod
    def of(
        cls,
        address: str,
        ca: PathLike | None,
        fingerprint: str | None,
        token: str | None,
        certificate: tuple[PathLike, PathLike] | None,
    ) -> Trust:
        parsed = Address.parse(address)
        if not parsed.is_encrypted:
            for name, option in (("ca", ca), ("fingerprint", fingerprint), ("certificate", certificate)):
                if option is not None:
                    raise ValueError(f"{name}: needs an address that begins with https://, found {address!r}")
        if ca is not None and fingerprint is not None:
            raise ValueError("fingerprint: cannot be combined with ca")
        return cls(
            address=parsed,
            ca=None if ca is None else _certificates(ca),
            fingerprint=None if fingerprint is None else checked_fingerprint(fingerprint),
            certificate=None if certificate is None else (_certificates(certificate[0]), _read(certificate[1])),
            metadata=() if token is None else (("authorization", f"Bearer {checked_token(token)}"),),
        )

    def fetch(self) -> Pinned:
        """Fetches the server's certificate. Raises `Unreachable`, and `WrongFingerprint` if it is not the pinned one."""
        try:
            return self._fetch()
        except ssl.SSLCertVerificationError as error:
            raise Untrusted(self.address.text, error.verify_message) from error
        except OSError as error:
            raise Unreachable(self.address.text, str(error)) from error

    def _fetch(self) -> Pinned:
        any_certificate = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        any_certificate.check_hostname = False
        any_certificate.verify_mode = ssl.CERT_NONE
        with self._handshake(any_certificate) as connection:
            der = connection.getpeercert(binary_form=True)
        found = hashlib.sha256(der or b"").hexdigest()
        if der is None or found != self.fingerprint:
            raise WrongFingerprint(self.address.text, self.fingerprint or "", found)
        pem = ssl.DER_cert_to_PEM_cert(der)
        # Python decodes only certificates that it has verified.
        this_certificate = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        this_certificate.check_hostname = False
        this_certificate.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
        this_certificate.load_verify_locations(cadata=pem)
        with self._handshake(this_certificate) as connection:
            return Pinned(pem.encode(), _name(connection.getpeercert() or {}))

    def _handshake(self, context: ssl.SSLContext) -> ssl.SSLSocket:
        connection = socket.create_connection((self.address.host, self.address.port), CONNECT_TIMEOUT_S)
        try:
            return context.wrap_socket(connection, server_hostname=self.address.host)
        except BaseException:
            connection.close()
            raise

    def channel(self, insecure: Any, secure: Any, pinned: Pinned | None) -> Any:
        """A channel, made by `grpc.insecure_channel` or `grpc.secure_channel`, or their asyncio versions."""
        if not self.address.is_encrypted:
            return insecure(self.address.target, options=CHANNEL_OPTIONS)
        certificate, key = self.certificate or (None, None)
        roots, options = self.ca, CHANNEL_OPTIONS
        if pinned is not None:
            # The fingerprint identifies the server, whatever its name.
            roots = pinned.pem
            name = ("grpc.ssl_target_name_override", pinned.name)
            # The name replaces the host of the calls, too, which may be no name of the server. grpc compares the host with
            # the certificate unless it has neither port nor brackets.
            is_ipv6 = ":" in self.address.host
            authority = ("grpc.default_authority", "localhost" if is_ipv6 else self.address.host)
            options = [*options, name, authority]
        elif roots is None:
            roots = _system_authorities()
        credentials = grpc.ssl_channel_credentials(roots, key, certificate)
        return secure(self.address.target, credentials, options=options)


@dataclass(frozen=True)
class Pinned:
    """A certificate with the expected fingerprint."""

    pem: bytes
    name: str
    """One of its names."""


def checked_fingerprint(fingerprint: str) -> str:
    """64 lower-case digits of a fingerprint with or without colons."""
    digits = fingerprint.strip().replace(":", "").lower()
    if len(digits) != 64 or any(digit not in "0123456789abcdef" for digit in digits):
        raise ValueError(f"fingerprint: expected the 64 hexadecimal digits of a SHA-256 fingerprint, found {fingerprint!r}")
    return digits


def checked_token(token: str) -> str:
    """A token without surrounding spaces."""
    token = token.strip()
    if not token or not token.isascii() or not token.isprintable():
        raise ValueError("token: expected printable ASCII letters without line breaks")
    return token


def _read(path: PathLike) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def _certificates(path: PathLike) -> bytes:
    pem = _read(path)
    if b"-----BEGIN CERTIFICATE-----" not in pem:
        raise ValueError(f"{os.fspath(path)}: expected a certificate in PEM, found none")
    return pem


def _system_authorities() -> bytes | None:
    """The authorities of the system; None for those that grpc brings."""
    paths = ssl.get_default_verify_paths()
    bundles = ("ca-certificates.crt", "ca-bundle.crt")
    candidates = [paths.cafile, *(os.path.join(paths.capath or "", bundle) for bundle in bundles)]
    found = next((path for path in candidates if path and os.path.isfile(path)), None)
    return None if found is None else _read(found)


def _name(certificate: Mapping[str, Any]) -> str:
    """A name that a certificate as `getpeercert` returns it is for: of a host if it has one, otherwise an IP address."""
    names = certificate.get("subjectAltName", ())
    subject = [pair for part in certificate.get("subject", ()) for pair in part]
    for kind, pairs in (("DNS", names), ("IP Address", names), ("commonName", subject)):
        for key, value in pairs:
            if key == kind:
                return str(value).replace("*", "any", 1)
    return "localhost"
