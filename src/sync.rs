//! What is made of these is shared between the bus thread and the program. The models of `loom/` compile the same files with their own.

pub(crate) use core::{
    hint::spin_loop,
    sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering, fence},
};
pub(crate) use std::sync::{Arc, Mutex, MutexGuard};
