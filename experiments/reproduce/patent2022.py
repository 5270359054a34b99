"""Patent2022: three-case control and planned descent."""
