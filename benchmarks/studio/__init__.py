"""How long the studio's page lets one wait, and what its server needs."""
