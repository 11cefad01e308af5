//! The bus thread: discovery, configuration, cyclic exchange.
