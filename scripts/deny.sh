#!/usr/bin/env bash
# Compares all crates with deny.toml, by cargo-deny where it is installed; says what was not compared.
set -euo pipefail
cd "$(dirname "$0")/.."

# Built from source it takes four minutes of one processor, which `make test` does not spend.
if ! command -v cargo-deny >/dev/null; then
  echo "cargo-deny is not installed: crates in two versions and known vulnerabilities are not looked for;" \
    "licences and sources are, by scripts/licences.py (fix: cargo install cargo-deny --locked)"
  exit
fi
cargo deny --offline check bans licenses sources
if compgen -G "${CARGO_HOME:-$HOME/.cargo}/advisory-dbs/*" >/dev/null; then
  cargo deny --offline check advisories
else
  echo "known vulnerabilities are not looked for: their database is not here (fix: cargo deny fetch)"
fi
