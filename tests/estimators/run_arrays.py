"""Everything in a run that is an array; what must be equal to the bit when two ways give the same run."""

RUN_ARRAYS = (
    "x",
    "x_std",
    "P",
    "trust",
    "suspected",
    "attack",
    "attack_std",
    "innovation",
    "innovation_std",
    "status",
)
