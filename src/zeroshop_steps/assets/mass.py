"""The mass of an object: measured, or from a usual density, with its uncertainty."""

from dataclasses import dataclass

from zeroshop_steps.runtime.errors import StepError, warn

PLAUSIBLE_KG = (0.0005, 100.0)
PLAUSIBLE_KG_M3 = (5.0, 23000.0)
SCALE_PITFALL = "Check the unit: masses are in kilograms, lengths in metres"


@dataclass(frozen=True)
class Mass:
    """A body's mass.

    Attributes:
        mass_kg: the mass.
        source: `measured`, or `density` where it is the volume times a usual density.
        factor: the true mass lies, with 68 % probability, between `mass_kg` divided and multiplied by this; 1 where it was measured.
    """

    mass_kg: float
    source: str
    factor: float


def find_mass(volume_m3: float, mass_kg: float | None, density_kg_m3: float | None, density_factor: float, name: str) -> Mass:
    """The mass of a body.

    Args:
        volume_m3: that its closed mesh encloses.
        mass_kg: the measured mass, if there is one.
        density_kg_m3: the usual density of the enclosed volume otherwise, hollow or full.
        density_factor: its uncertainty, a factor above 1.
        name: of the mesh's file, for messages.

    Raises:
        StepError: neither is given, or the mass is not that of something that lies on a table.
    """
    if mass_kg is None and density_kg_m3 is None:
        raise StepError(
            f"{name} has no mass: give mass_kg (a column of objects.tsv, or assets.masses_kg in the config), or a usual density,"
            " assets.density_kg_m3"
        )
    if mass_kg is not None:
        found = Mass(mass_kg, "measured", 1.0)
    else:
        assert density_kg_m3 is not None
        found = Mass(volume_m3 * density_kg_m3, "density", density_factor)
        warn(
            f"the mass of {name} was not measured: {found.mass_kg:.3g} kg is its volume times {density_kg_m3:g} kg/m^3, right within a"
            f" factor of {density_factor:g}. Weigh it and give mass_kg"
        )
    if not PLAUSIBLE_KG[0] <= found.mass_kg <= PLAUSIBLE_KG[1]:
        raise StepError(
            f"{name} would weigh {found.mass_kg:.3g} kg; expected {PLAUSIBLE_KG[0]:g} to {PLAUSIBLE_KG[1]:g} kg. {SCALE_PITFALL}"
        )
    density = found.mass_kg / volume_m3
    if not PLAUSIBLE_KG_M3[0] <= density <= PLAUSIBLE_KG_M3[1]:
        raise StepError(
            f"{name} encloses {1e6 * volume_m3:.3g} cm^3, so {found.mass_kg:.3g} kg would be {density:.3g} kg/m^3; expected"
            f" {PLAUSIBLE_KG_M3[0]:g} to {PLAUSIBLE_KG_M3[1]:g}. {SCALE_PITFALL}"
        )
    return found
