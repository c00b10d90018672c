"""How far two values may differ that should agree."""

#: Share of a value by which approximations of it may differ. Chosen: 1 %, far above the errors of differences and far
#: below that of a wrong formula.
AGREEMENT = 0.01
#: Share of the range of a variable that counts as no change. Chosen: above the square root of the precision of doubles,
#: 1.5e-8, which is the error of a difference.
NO_CHANGE = 1e-7
#: Relative difference of two doubles that a conversion to another unit and back may leave. Chosen: a few thousand
#: units in the last place.
ROUNDING = 1e-12
