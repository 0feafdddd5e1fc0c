"""Closing a surface: the underside, holes and hollows, by what photos say of the space around it."""
