"""Lines of ``print(problem)`` about an interface."""

from __future__ import annotations

from dolfinx_llm.interface.geometry import InterfaceGeometry


def describe(model: InterfaceGeometry) -> list[str]:
    """Lines for ``print(problem)``: what an interface consists of, what it leaves out and why."""
    law, nodes = model.interface.law, " + ".join(str(len(p.nodes)) for p in model.pairs)
    kind = "that may touch" if law.opens else "in contact"
    frame = "no frame" if model.frame is None else f"frame of {len(model.frame.x)} nodes"
    lines = [
        f"  interface {model.interface.name}, {law}: {nodes} nodes {kind}, {frame}, "
        f"area {model.area:.9g}"
    ]
    if model.frame is not None and model.certificate is not None:
        c, q = model.certificate, model.frame.quality
        lines += [
            f"    patch residual {c.residual:.1e} (before design {c.residual_before:.1e}), "
            f"singular values of L_b {c.singular_values[0]:.3g} to "
            f"{c.singular_values[1]:.3g}, linear fields to {c.linear:.1e}",
            f"    frame: angles {q.min_angle:.1f}° to {q.max_angle:.1f}°, shortest side "
            f"{q.min_side:.3g}",
        ]
    lines += [f"    {note}" for note in model.notes]
    if any(model.forced):
        lines.append(f"    the obstacle moves in {model.directions.shape[1]} way(s) under a force")
    out = []
    if model.frame is None:
        out.append("frame, second side and proximal term (rigid obstacle)")
    if law.ties:
        out.append("active set and local bases (tied)")
    elif law.components == "normal":
        out.append("tangential multipliers, tangential frame unknowns and slip (no friction)")
    return lines + [f"    left out: {text}" for text in out]
