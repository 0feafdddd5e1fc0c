"""Arms of six joints: their kinematics, clearance and motions between viewpoints."""
