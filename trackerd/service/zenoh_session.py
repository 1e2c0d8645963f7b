"""A Zenoh session as the configuration asks for it: explicit endpoints only, no multicast scouting, a short lease."""

import json
import re
from typing import Any

import zenoh

from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.formats.settings import ZenohSettings


class RefusedStart(TrackerdError):
    """The surroundings forbid to start: a port is taken, or somebody else publishes on the key."""


def open_listening(settings: ZenohSettings) -> zenoh.Session:
    """The daemon's session. Blocks for some ms. Raises RefusedStart or ConfigError."""
    return _open(settings, {"listen/endpoints": list(settings.listen), "connect/endpoints": list(settings.connect)})


def open_towards(settings: ZenohSettings) -> zenoh.Session:
    """A session of a watcher or commander: it connects where the daemon listens, and listens nowhere itself."""
    reachable = [endpoint.replace("0.0.0.0", "127.0.0.1") for endpoint in settings.listen]
    endpoints = [*reachable, *settings.connect]
    changes = {"mode": "client", "listen/endpoints": [], "connect/endpoints": endpoints, "connect/timeout_ms": 2000}
    return _open(settings, changes)


def _open(settings: ZenohSettings, changes: dict[str, Any]) -> zenoh.Session:
    config = _base(settings)
    values = {
        "mode": settings.mode,
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,  # messages are small; every process would leave a file in /dev/shm
        "transport/link/tx/lease": settings.lease_ms,
        **changes,
    }
    for path, value in values.items():
        _insert(config, path, value)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise RefusedStart(_in_words(settings, str(error))) from error


def _insert(config: zenoh.Config, path: str, value: Any) -> None:
    try:
        config.insert_json5(path, json.dumps(value))
    except zenoh.ZError as error:
        raise ConfigError(f"[zenoh] {path.partition('/')[0]} = {value}: {_first_sentence(str(error))}") from error


def _base(settings: ZenohSettings) -> zenoh.Config:
    if settings.overlay is None:
        return zenoh.Config()
    try:
        return zenoh.Config.from_file(str(settings.overlay))
    except zenoh.ZError as error:
        raise ConfigError(f"[zenoh] overlay = {settings.overlay}: {_first_sentence(str(error))}") from error


def _in_words(settings: ZenohSettings, answer: str) -> str:
    taken = re.search(r"bound to (\S+?):? .*Address already in use", answer)
    if taken:
        return (
            f"[zenoh] listen = {taken[1]}: the port is taken by another process"
            " (another trackerd or a Zenoh router?): stop it, or choose another port"
        )
    silent = re.search(r"Unable to connect to any of \[(?:\w+\()?(.*?)\)?\]", answer)
    if silent:
        return f"[zenoh] nobody answers at {silent[1]}: is the daemon (or the router) running?"
    return f"[zenoh] listen = {list(settings.listen)}, connect = {list(settings.connect)}: {_first_sentence(answer)}"


def _first_sentence(answer: str) -> str:
    """Zenoh wraps its words into its own types, and appends where in its sources an error arose; nobody can act on that."""
    answer = answer.rpartition('Message { msg: "')[2].partition('", location: ')[0]
    return re.split(r" at /|\bat [^ ]*/src/", answer)[0].strip().rstrip(":.[")
