"""Images without a probe: what is found there is false."""

from collections.abc import Iterable

from limits import upper_95
from peers import PEERS, anywhere, near_guess
from tables import Table
from trials import GUESSED_PX, Trial, ours

from trackerd.contract.model import Found
from trackerd.vision.locate import locate


def absent_table(frames: Iterable[Trial], with_peers: bool) -> Table:
    """Half of the frames with a guess that points anywhere, the others searched as a whole."""
    names = ["ours", *(PEERS if with_peers else ())]
    false = {name: [0, 0] for name in names}  # guessed, searched
    asked = [0, 0]
    for n, trial in enumerate(frames):
        asked[n % 2] += 1
        for name in names:
            false[name][n % 2] += _finds(name, trial, searching=bool(n % 2))
    columns = ("guessed: false", "frames", "searched: false", "frames", "both at 95 % less than, %")
    table = Table("Detections in images without a probe", columns)
    for name in names:
        guessed, searched = false[name]
        upper = 100.0 * upper_95(guessed + searched, sum(asked))
        verdict = "" if name != "ours" else "MISSED" if guessed + searched else "met"
        table.add(name, guessed, asked[0], searched, asked[1], upper, verdict=verdict, limit="0 detections" if verdict else "")
    return table


def _finds(name: str, trial: Trial, searching: bool) -> bool:
    if name == "ours":
        outline = locate(trial.image, None, trial.noise, view=trial.view) if searching else ours(trial)
        return isinstance(outline, Found)
    peer = PEERS[name]
    found = anywhere(peer, trial.image, GUESSED_PX) if searching else near_guess(peer, trial.image, trial.guess)
    return found is not None
