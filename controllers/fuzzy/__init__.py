"""The fuzzy inference engine, equations (43) to (50)."""
