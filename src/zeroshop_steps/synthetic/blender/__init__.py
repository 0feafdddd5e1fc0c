"""What runs inside BlenderProc's environment: modules that import nothing else of this package, whose libraries are not there."""
