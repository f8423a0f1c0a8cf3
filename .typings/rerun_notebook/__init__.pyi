from typing import Any

Viewer: Any
