"""What virtual scenes consist of: tables, tops, rooms, clutter and things that distract, and where cameras go."""
