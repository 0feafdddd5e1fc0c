"""Whether masks are right without a truth: scores, agreement between views, and tidying by their common hull."""
