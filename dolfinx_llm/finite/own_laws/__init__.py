"""Laws of one's own at pairs of both kinds."""
