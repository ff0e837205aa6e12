"""What is compared with what: scenes, sizes, methods, diagrams."""

SADDLE, CHOLESKY, GAMG = "saddle", "condensed Cholesky", "condensed CG + GAMG"
POSITIONS, WEIGHTS, UNDESIGNED = "frame by positions", "frame by weights", "undesigned frame"
NODE_TO_SEGMENT, MPC, MATCHING = "node to segment", "dolfinx_mpc", "matching mesh"
# Opening and friction, as "auto" takes them, factorised, and by multigrid.
LAW, CHOSEN, MULTIGRID = "contact law", "auto", "condensed GAMG"
# n: cells split n times, bricks a side, elements over the half-width or radius of contact.
SIZES = {
    "patch test": (1, 2, 3, 4), "manufactured": (2, 4, 8, 16), "Hertz": (8, 16, 32, 64),
    "Hertz 3D": (3, 4, 6, 9), "Cattaneo-Mindlin": (8, 16, 32, 64), "dragged block": (4, 6, 9, 13),
}  # fmt: skip
QUICK = {"patch test": (1, 2), "manufactured": (4, 8), "Hertz": (8, 16), "Hertz 3D": (3, 4),
         "Cattaneo-Mindlin": (8, 16), "dragged block": (4, 6)}  # fmt: skip
# Unknowns of more sizes, which an argument asks for; they are not factorised.
LARGE = {"Hertz 3D": {12: 206_550, 15: 385_728}, "Cattaneo-Mindlin": {128: 53_628, 256: 89_920},
         "dragged block": {20: 86_832, 26: 187_674, 33: 373_464}}  # fmt: skip
FRAMES = [(POSITIONS, SADDLE), (WEIGHTS, SADDLE), (WEIGHTS, CHOLESKY), (WEIGHTS, GAMG),
          (UNDESIGNED, SADDLE)]  # fmt: skip
LIMIT = [(MATCHING, CHOLESKY), (MATCHING, GAMG)]
SEGMENTS = [(f"{NODE_TO_SEGMENT}, slave {k}", SADDLE) for k in (0, 1)]
CASES = {
    # There the foundation cannot be dolfinx_mpc's slave: not all of its nodes face the punch.
    "patch test": [*FRAMES, *SEGMENTS, (f"{MPC} tied, slave 1", CHOLESKY),
                   (f"{MPC} tied, slave 1", GAMG), (f"{MPC} slip, slave 1", CHOLESKY), *LIMIT],
    "manufactured": [*FRAMES, *SEGMENTS, *((f"{MPC} tied, slave {k}", solver) for k in (0, 1)
                     for solver in (CHOLESKY, GAMG)), *LIMIT],
    # With frames by weights the condensed form's contact law does not converge here.
    "Hertz": [(POSITIONS, SADDLE), (POSITIONS, CHOLESKY), (POSITIONS, GAMG), (WEIGHTS, SADDLE),
              (UNDESIGNED, SADDLE), (MATCHING, SADDLE)],
    # The matching mesh is one linear solve of as many unknowns: what the law costs is the rest.
    **{scene: [(LAW, CHOSEN), (LAW, SADDLE), (LAW, MULTIGRID), (MATCHING, GAMG)]
       for scene in ("Hertz 3D", "dragged block")},
    "Cattaneo-Mindlin": [(LAW, CHOSEN), (LAW, SADDLE), (LAW, MULTIGRID)],
}  # fmt: skip
# The search for positions has nothing to move in the cubes at n = 2 and finds no frame at n = 8.
POSITIONS_SIZES = {("manufactured", False): (4,), ("manufactured", True): (4,),
                   ("patch test", True): (1,)}  # fmt: skip
DIAGRAMS = [  # scene, error, title
    ("patch test", "von_mises", "3D patch test: largest error of von Mises"),
    ("manufactured", "l2", "manufactured: displacement, L2"),
    ("manufactured", "pressure", "manufactured: contact pressure, L2"),
    ("Hertz", "pressure", "Hertz: contact pressure, L2"),
]
LAWS = [  # of opening and friction
    ("Hertz 3D", "pressure", "Hertz 3D: contact pressure, rms inside 0.8 a"),
    ("Cattaneo-Mindlin", "traction", "Cattaneo and Mindlin: friction, L2"),
    ("dragged block", "friction", "dragged block: friction against μ N"),
]
STAGES = ("mesh", "bulk assembly", "surfaces", "patch forces", "design", "location", "operators",
          "set-up", "solve", "law")  # fmt: skip
# What CPU times are compared with: nearly all that is noise in both is the machine's.
REFERENCE = {"patch test": (MATCHING, GAMG), "manufactured": (MATCHING, GAMG),
             "Hertz": (MATCHING, SADDLE), "Hertz 3D": (MATCHING, GAMG),
             "dragged block": (MATCHING, GAMG), "Cattaneo-Mindlin": (LAW, SADDLE)}  # fmt: skip
ROUNDING = 1e-11  # errors below are as good as none: smaller ones do not make a method better


def sizes_of(scene, method, solver, quick, largest=0):
    """Sizes at which a method is run on a scene; more of them up to ``largest`` unknowns."""
    every = (QUICK if quick else SIZES)[scene]
    if solver != SADDLE:
        every += tuple(n for n, size in LARGE.get(scene, {}).items() if size <= largest)
    return POSITIONS_SIZES.get((scene, quick), every) if method == POSITIONS else every
