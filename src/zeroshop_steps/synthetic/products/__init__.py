"""Shop products drawn and shaped by code: their solids, their printed surfaces and how both become one textured mesh."""
