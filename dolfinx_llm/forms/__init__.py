"""Forms in which (31) is solved: saddle, flexibility, condensed."""
