"""The section `delivery`: new configurations from an operator, over an IP network."""

from __future__ import annotations

from pydantic import model_validator

from phm.core.settings.base import AbsolutePath, ListenAddress, Section, host_and_port


class DeliverySettings(Section):
    """New configurations from an operator, over an IP network (docs/reference/security.md). The holder of the key can run programs as
    PHM."""

    listen: ListenAddress | None = None
    """Address and port for `phm deliver`, e.g. 10.0.0.7:9465. Default: nothing listens."""
    key: AbsolutePath | None = None
    """File with the key, 32 bytes or 64 hexadecimal digits, that only its owner can read. Not the key of `mavlink.signing`."""

    @model_validator(mode="after")
    def _complete(self) -> DeliverySettings:
        if self.listen is not None and self.key is None:
            raise ValueError(
                "listen needs a key: `openssl rand -hex 32 > delivery.key`, `chmod 600 delivery.key`, and give its path as `key`"
            )
        return self

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of `listen`, which must be set."""
        return host_and_port(self.listen or "")
