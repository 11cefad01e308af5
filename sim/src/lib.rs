//! A simulated EtherCAT segment with DS402 drives: bytes in, bytes out.
pub mod ds402;
