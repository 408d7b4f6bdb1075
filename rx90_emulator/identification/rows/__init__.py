"""Sources of rows: what recordings say about friction and the rigid body, as equations for a fit."""
