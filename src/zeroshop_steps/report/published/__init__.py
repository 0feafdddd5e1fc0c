"""The thesis's published figures, and which of ours may stand beside each."""
