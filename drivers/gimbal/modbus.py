"""Gimbal controllers over Modbus TCP: one transaction a cycle writes the command record and reads the status record."""

from typing import Annotated

from pydantic import Field

from trackerd.formats.settings import GimbalSettings


class Settings(GimbalSettings):
    host: Annotated[str, Field(min_length=1)]
    port: Annotated[int, Field(ge=0, le=65535)] = 502  # 0: the twin tells its own
    unit: Annotated[int, Field(ge=0, le=247)] = 1
    timeout_ms: Annotated[int, Field(ge=20, le=1000)] = 50  # of one request and of the connection
