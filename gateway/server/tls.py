"""TLS of the listener: one context for its whole life, behind which a renewed certificate takes the old one's place.

No Strict-Transport-Security is sent: most cells have a certificate of their own making, and a browser that has once
seen that header would not let its user in any more when such a certificate is replaced.
"""

from __future__ import annotations

import ssl
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime

import structlog
from aiohttp import web

from gateway.config.certificates import Certificate, CertificateError, TlsFiles, load_certificate
from gateway.server.repeating import repeating

_LOG = structlog.get_logger()
LOOK_S = 60.0
SOON_S = 14 * 86400.0
_DAY_S = 86400.0
_Seen = tuple[tuple[int, int, int, int], ...]


class Tls:
    """The certificate that is shown now, if any.

    Args:
        files: Where it is; None: the doors speak in the clear.
        now: UTC, in s since 1970.

    Attributes:
        context: For the listener, the same one from certificate to certificate; None: the doors speak in the clear.
        expires: Until when the certificate that is shown is valid, UTC.

    Raises:
        CertificateError: It cannot be used.
    """

    def __init__(self, files: TlsFiles | None, now: Callable[[], float] = time.time) -> None:
        self._now = now
        self._files: TlsFiles | None = None
        self._seen: _Seen = ()
        self._warned_s = 0.0
        self._shown: ssl.SSLContext | None = None
        self.context: ssl.SSLContext | None = None
        self.expires: datetime | None = None
        if files is not None:
            seen = _seen(files)
            self._show(files, seen, load_certificate(files))

    def reload(self, files: TlsFiles | None) -> bool:
        """Read a certificate, at once; who is connected stays so.

        Args:
            files: Where it is now; None: no more certificate is shown.

        Returns:
            Whether it can be used; what was shown before stays when it cannot, and the log says why.
        """
        if files is None:
            self._files = self.context = self._shown = self.expires = None
            return True
        seen = _seen(files)
        try:
            loaded = load_certificate(files)
        except CertificateError as error:
            if files == self._files:
                self._seen = seen  # told once; tried again when they change again
            _LOG.error("certificate.refused", reason=f"{error}; what was shown before stays")
            return False
        self._show(files, seen, loaded)
        return True

    def look(self) -> None:
        """Reload when the files have changed, and warn once a day of an end that is near."""
        if self._files is None:
            return
        if _seen(self._files) != self._seen:
            self.reload(self._files)
        elif self._now() - self._warned_s >= _DAY_S:
            self._warn()

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Look at the files every minute for as long as the context lasts."""
        with repeating(LOOK_S, self.look):
            yield

    def _show(self, files: TlsFiles, seen: _Seen, loaded: Certificate) -> None:
        self._files, self._seen, self._shown, self.expires = files, seen, loaded.context, loaded.expires
        if self.context is None:
            self.context = loaded.context
            self.context.sni_callback = self._on_handshake
        _LOG.info("certificate.loaded", expires=f"{loaded.expires:%Y-%m-%d}")
        self._warn()

    def _on_handshake(self, connection: ssl.SSLSocket | ssl.SSLObject, _name: str | None, _: ssl.SSLContext) -> None:
        """Called by OpenSSL in each handshake, whether or not the client names a server."""
        if self._shown is not None:
            connection.context = self._shown

    def _warn(self) -> None:
        """Say that the certificate has expired or soon will."""
        if self._files is None or self.expires is None:
            return
        left_s = self.expires.timestamp() - self._now()
        if left_s < SOON_S:
            self._warned_s = self._now()
            what = "it has expired: clients refuse it" if left_s <= 0 else f"it expires in {left_s / _DAY_S:.0f} days"
            _LOG.warning("certificate.expiring", reason=f"{what}; renew {self._files.certificate}")


TLS = web.AppKey("tls", Tls)


def _seen(files: TlsFiles) -> _Seen:
    """What tells that a file is another one, or was written anew; follows symbolic links, as renewals exchange them."""
    found = []
    for path in (files.certificate, files.key):
        try:
            status = path.stat()
        except OSError:
            found.append((0, 0, 0, 0))
        else:
            found.append((status.st_dev, status.st_ino, status.st_mtime_ns, status.st_size))
    return tuple(found)
