"""What can be said of an interface before any solve."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Certificate:
    """What can be said of an interface before any solve."""

    residual: float  # max |r| / max f, (28); of curved surfaces in space, or along their normals
    # where nothing else acts
    residual_before: float  # the same before design
    singular_values: tuple[float, float]  # smallest and largest of the scalar L_b
    linear: float  # max |sum_J N_J Y_J - X_p| in the plane, over the diameter
    largest_correction: float  # of an entry of L_b by design
    place: float = 0.0  # about how well curved surfaces are known between their nodes [length]
