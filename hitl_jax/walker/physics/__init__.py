"""One step of the world, as Box2D makes it: bodies, joints, contacts and impacts."""
