"""The moving frame: places of nodes on it, common areas, designed rows; with derivatives."""
