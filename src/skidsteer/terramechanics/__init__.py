"""Physics of wheels on the ground: shear stress under the patches, steady turns, and motion in time."""
