"""Hearts and venous reservoirs: components of a circulation without spatial extent."""
