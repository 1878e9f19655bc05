from collections.abc import Sequence

def encoder_edges(
    from_rad: Sequence[float],
    to_rad: Sequence[float],
    counts_per_rad: Sequence[float],
    offset_count: Sequence[float],
) -> list[tuple[float, int, int]]: ...
def encoder_counts(
    angle_rad: Sequence[float], counts_per_rad: Sequence[float], offset_count: Sequence[float]
) -> list[int]: ...
