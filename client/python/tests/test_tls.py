"""Encrypted connections to a real server: `roundel serve` with a self-signed certificate."""

from __future__ import annotations

import asyncio
import re
import shutil
import socket
import subprocess
from pathlib import Path
from typing import Iterator

import pytest

from roundel import (
    Client,
    InvalidAddress,
    PermissionDenied,
    Subscription,
    Unauthenticated,
    Unreachable,
    Untrusted,
    WrongFingerprint,
    aio,
)
from roundel._trust import checked_fingerprint, checked_token

from conftest import ConfiguredServer, binary

CONFIG = """
name = "lab"
[server]
listen = "127.0.0.1:0"
tls = { certificate = "cert.pem", key = "key.pem", self_signed = true }
[[roundel]]
name = "robot"
outer_mm = 160.0
inner_mm = 64.0
[[camera]]
name = "north"
source = "sim:"
"""
# With a certificate that an authority has issued.
ISSUED_CONFIG = CONFIG.replace("cert.pem", "own.pem").replace("key.pem", "own-key.pem").replace(", self_signed = true", "")


class TlsServer(ConfiguredServer):
    """A server that prints its certificate's fingerprint."""

    def __init__(self, folder: Path, config: str = CONFIG) -> None:
        (folder / "lab.toml").write_text(config)
        super().__init__(folder / "lab.toml")
        found = re.search(r"TLS certificate: SHA-256 fingerprint (\w{64}), expires", self.output)
        if found is None:
            self.stop()
            pytest.fail(f"no fingerprint:\n{self.output}")
        self.fingerprint = found[1]
        self.certificate = folder / "cert.pem"


@pytest.fixture(scope="module")
def tls_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TlsServer]:
    running = TlsServer(tmp_path_factory.mktemp("tls"))
    yield running
    running.stop()


def test_a_pinned_fingerprint_is_trusted(tls_server: TlsServer) -> None:
    colons = ":".join(re.findall("..", tls_server.fingerprint.upper()))
    for fingerprint in (tls_server.fingerprint, colons):
        with Client.connect(tls_server.url, fingerprint=fingerprint, token="secret") as client:
            assert client.info().name == "lab"
            assert next(iter(client.snapshots(Subscription()))).source_id


def test_a_certificate_file_is_trusted_as_its_own_authority(tls_server: TlsServer) -> None:
    with Client.connect(tls_server.url, ca=tls_server.certificate) as client:
        assert client.info().name == "lab"


def test_an_untrusted_server_is_a_typed_error(tls_server: TlsServer) -> None:
    with pytest.raises(WrongFingerprint) as caught:
        Client.connect(tls_server.url, fingerprint="ab" * 32)
    assert caught.value.found == tls_server.fingerprint and not caught.value.is_temporary
    with pytest.raises(Untrusted, match="not trusted"):
        Client.connect(tls_server.url)
    with Client(tls_server.url, fingerprint="ab" * 32) as client:
        with pytest.raises(WrongFingerprint):
            next(iter(client.updates()))


def test_a_pinned_server_may_come_up_later() -> None:
    with Client("https://127.0.0.1:9", fingerprint="ab" * 32) as client:
        with pytest.raises(Unreachable):
            client.info()


def test_the_asyncio_client_pins_too(tls_server: TlsServer) -> None:
    async def names() -> tuple[str, str]:
        async with await aio.Client.connect(tls_server.url, fingerprint=tls_server.fingerprint) as client:
            async for snapshot in client.snapshots():
                return (await client.info()).name, snapshot.source_id
        raise AssertionError("no snapshot")

    name, source_id = asyncio.run(names())
    assert name == "lab" and source_id


class Authority:
    """A certificate authority in a folder, `ca.pem`, made with openssl as in deploy/README.md."""

    CURVE = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")

    def __init__(self, folder: Path) -> None:
        if shutil.which("openssl") is None:
            pytest.skip("openssl is not installed")
        self.folder = folder
        self.self_signed("ca", "lab authority")

    def self_signed(self, file: str, name: str) -> None:
        files = ("-keyout", f"{file}-key.pem", "-out", f"{file}.pem")
        self._openssl("req", "-x509", *self.CURVE, *files, "-subj", f"/CN={name}")

    def issue(self, file: str, name: str, extension: str) -> None:
        self._openssl("req", *self.CURVE, "-keyout", f"{file}-key.pem", "-out", f"{file}.csr", "-subj", f"/CN={name}")
        (self.folder / "extension.txt").write_text(extension)
        issuer = ("-CA", "ca.pem", "-CAkey", "ca-key.pem", "-days", "30", "-extfile", "extension.txt")
        self._openssl("x509", "-req", "-in", f"{file}.csr", *issuer, "-out", f"{file}.pem")

    def _openssl(self, *arguments: str) -> None:
        subprocess.run(["openssl", *arguments], check=True, cwd=self.folder, capture_output=True)


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path)


def test_a_certificate_of_an_authority_is_trusted_for_its_names(authority: Authority) -> None:
    folder = authority.folder
    for names, is_trusted in (("IP:127.0.0.1,DNS:arena", True), ("DNS:arena", False), ("DNS:*.arena", False)):
        authority.issue("own", "arena", f"subjectAltName={names}")
        server = TlsServer(folder, ISSUED_CONFIG)
        try:
            if is_trusted:
                with Client.connect(server.url, ca=folder / "ca.pem") as client:
                    assert next(client.snapshots()).source_id == client.info().source_id
            else:
                with pytest.raises(Untrusted, match="not for this name or address"):
                    Client.connect(server.url, ca=folder / "ca.pem")
                with Client(server.url, ca=folder / "ca.pem") as client, pytest.raises(Untrusted):
                    next(client.updates())
            with pytest.raises(Untrusted):
                Client.connect(server.url)
            # A pinned certificate is trusted whatever its name.
            with Client.connect(server.url, fingerprint=server.fingerprint) as client:
                assert client.info().name == "lab"
        finally:
            server.stop()


def test_a_pinned_certificate_may_have_another_name_over_ipv6(authority: Authority) -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this computer has no IPv6")
    authority.issue("own", "arena", "subjectAltName=DNS:arena")
    server = TlsServer(authority.folder, ISSUED_CONFIG.replace("127.0.0.1", "[::1]"))
    try:
        with Client.connect(server.url, fingerprint=server.fingerprint) as client:
            assert client.info().name == "lab"
    finally:
        server.stop()


def test_credentials_are_checked_over_tls(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text(CONFIG)
    command = [str(binary()), "token", "add", "viewer", "--role", "view", "--config", str(tmp_path / "lab.toml")]
    token = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    server = TlsServer(tmp_path, (tmp_path / "lab.toml").read_text())
    try:
        with Client.connect(server.url, fingerprint=server.fingerprint, token=token) as client:
            assert client.cameras()[0].name == "north"
            with pytest.raises(PermissionDenied):
                client.configuration()
        for wrong in (None, "guessed"):
            with Client(server.url, fingerprint=server.fingerprint, token=wrong) as client:
                with pytest.raises(Unauthenticated):
                    client.cameras()
                with pytest.raises(Unauthenticated):
                    next(client.snapshots())
    finally:
        server.stop()


def test_a_client_certificate_is_presented(authority: Authority) -> None:
    tmp_path = authority.folder
    authority.issue("own", "robot7", "extendedKeyUsage=clientAuth")
    authority.self_signed("foreign", "robot7")
    server = TlsServer(tmp_path, CONFIG.replace("self_signed", 'client_ca = "ca.pem", self_signed'))
    try:
        own = (tmp_path / "own.pem", tmp_path / "own-key.pem")
        with Client.connect(server.url, ca=server.certificate, certificate=own) as client:
            assert client.info().name == "lab"
        with Client.connect(server.url, fingerprint=server.fingerprint) as client:
            assert client.info().name == "lab"
        foreign = (tmp_path / "foreign.pem", tmp_path / "foreign-key.pem")
        with pytest.raises(Unreachable):
            Client.connect(server.url, ca=server.certificate, certificate=foreign, timeout_s=3.0)
    finally:
        server.stop()


def test_invalid_options_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="ca: needs an address that begins with https://"):
        Client("http://127.0.0.1:7670", ca=tmp_path / "ca.pem")
    with pytest.raises(FileNotFoundError):
        Client("https://127.0.0.1:7670", ca=tmp_path / "ca.pem")
    (tmp_path / "ca.pem").write_text("hello")
    with pytest.raises(ValueError, match="expected a certificate in PEM"):
        Client("https://127.0.0.1:7670", ca=tmp_path / "ca.pem")
    with pytest.raises(ValueError, match="cannot be combined"):
        Client("https://127.0.0.1:7670", ca=tmp_path / "ca.pem", fingerprint="ab" * 32)
    for wrong in ("", "12", "zz" * 32):
        with pytest.raises(ValueError, match="64 hexadecimal digits"):
            checked_fingerprint(wrong)
    for wrong in ("", " ", "two\nlines", "ü"):
        with pytest.raises(ValueError, match="printable ASCII"):
            checked_token(wrong)
    with pytest.raises(InvalidAddress):
        Client("ftp://127.0.0.1:7670")
