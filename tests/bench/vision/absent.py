"""Images without a probe: what is found there is false."""

from collections.abc import Iterable

from limits import upper_95
from peers import PEERS, near_guess
from tables import Table
from trials import Trial, ours

from trackerd.contract.model import Found
from trackerd.vision.locate import locate


def absent_table(frames: Iterable[Trial], with_peers: bool) -> Table:
    """Half of the frames with a guess that points anywhere, the others searched as a whole; the peers are always guessed."""
    names = ["ours, guessed", "ours, searched", *(PEERS if with_peers else ())]
    false, asked = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    for n, trial in enumerate(frames):
        name = names[n % 2]
        outline = ours(trial) if name == "ours, guessed" else locate(trial.image, None, trial.noise, view=trial.view)
        asked[name] += 1
        false[name] += isinstance(outline, Found)
        for rival in names[2:]:
            asked[rival] += 1
            false[rival] += near_guess(PEERS[rival], trial.image, trial.guess) is not None
    table = Table("Detections in images without a probe", ("false", "frames", "at 95 % less than, %"))
    both = sum(false[name] for name in names[:2]), sum(asked[name] for name in names[:2])
    verdict = "MISSED" if both[0] else "met"
    table.add("ours", *both, 100.0 * upper_95(*both), verdict=verdict, limit="0 detections")
    for name in names:
        table.add(name, false[name], asked[name], 100.0 * upper_95(false[name], asked[name]))
    return table
