recorded=stale=None
