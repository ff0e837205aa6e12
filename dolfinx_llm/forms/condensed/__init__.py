"""The condensed form: surfaces' displacements written in the frame's."""
