//! The readers from outside: what they read, what they refuse, what they stand.

mod common;
mod facets;
mod features;
mod hostile;
mod scenes;
