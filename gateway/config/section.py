"""What every table of the file is, and how it names a secret that stands elsewhere."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, model_validator

from gateway.errors import BadConfig


class Section(BaseModel):
    """A table of the file: unknown keys are refused, values are not coerced."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Secret(Section):
    """A secret that stands elsewhere: in an environment variable or in a file."""

    env: str | None = Field(None, description="name of the environment variable that holds it")
    file: str | None = Field(None, description="path of the file that holds it (its last newline is dropped)")

    @model_validator(mode="after")
    def _one_place(self) -> Secret:
        if (self.env is None) == (self.file is None):
            raise ValueError('say where it stands: { env = "NAME" } or { file = "/path" }')
        return self

    def reveal(self, environment: Mapping[str, str] = os.environ) -> str:
        """Return the secret; BadConfig says which variable or file is missing."""
        if self.env is not None:
            if self.env not in environment:
                raise BadConfig(f"environment variable {self.env} is not set")
            return environment[self.env]
        try:
            return Path(self.file or "").read_text(encoding="utf-8").removesuffix("\n")
        except (OSError, UnicodeDecodeError) as error:
            raise BadConfig(f"secret file {self.file}: {error}") from error
