//! PDO mapping: declared once, written by the rules, read back, laid out.
