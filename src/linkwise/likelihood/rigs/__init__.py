"""Links alone on a rig: laws of links whose ends move as recorded, from the forces that load cells show."""
