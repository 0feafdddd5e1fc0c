"""Depth Anything 3 (Lin et al., Depth Anything 3: Recovering the Visual Space from Any Views, 2025): its sizes small and base."""
