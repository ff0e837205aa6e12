"""Errors that users see."""


class ContactError(RuntimeError):
    """The scene cannot be solved as it stands; the message says why and what to do."""


class ContactInputError(ContactError, ValueError):
    """An argument (tag, frame, function space, parameter) that does not fit the scene."""
