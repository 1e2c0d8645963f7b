"""What the target looks like, from the outlines that were verified: its size, its grey level and what it stands out by."""

from dataclasses import dataclass

from trackerd.contract.model import Found

NEWEST = 0.2  # share of a new outline in the look: light and range change slowly
SAME_LEVEL, SAME_LEVEL_DN = 0.4, 8.0  # of the ball's own level, where it stands out to the same side
NEAR_LEVEL, NEAR_LEVEL_DN = 0.15, 4.0  # and where it does not: before a background that is now the brighter one


@dataclass(frozen=True, slots=True)
class Look:
    """Radius, and grey levels by the sectors that carry an edge."""

    r_px: float
    inside_dn: float
    contrast_dn: float  # inside minus outside

    @staticmethod
    def of(found: Found) -> "Look":
        return Look(found.r_px, found.inside_dn, found.inside_dn - found.outside_dn)

    def with_newer(self, found: Found) -> "Look":
        newer = Look.of(found)
        return Look(
            newer.r_px,
            self.inside_dn + NEWEST * (newer.inside_dn - self.inside_dn),
            self.contrast_dn + NEWEST * (newer.contrast_dn - self.contrast_dn),
        )

    def has_levels(self, found: Found) -> bool:
        """Tells a ball from a round hole and from one of another brightness; equal balls look equal."""
        return self.has_levels_of(Look.of(found))

    def may_be_of(self, other: "Look") -> bool:
        """Whether a ball that looked like the other may look like this, before whatever background."""
        return abs(other.inside_dn - self.inside_dn) <= SAME_LEVEL * self.inside_dn + SAME_LEVEL_DN

    def has_levels_of(self, other: "Look") -> bool:
        off_dn = abs(other.inside_dn - self.inside_dn)
        if other.contrast_dn * self.contrast_dn > 0.0:
            return off_dn <= SAME_LEVEL * self.inside_dn + SAME_LEVEL_DN
        return off_dn <= min(NEAR_LEVEL * self.inside_dn + NEAR_LEVEL_DN, abs(self.contrast_dn))


def same_size(r_px: float, expected_px: float, growth: float) -> bool:
    """Whether a radius is the expected one but for a share of it, larger or smaller."""
    return expected_px / (1.0 + growth) <= r_px <= expected_px * (1.0 + growth)
