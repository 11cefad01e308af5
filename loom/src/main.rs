//! Every order in which threads can run is tried on what the bus thread and the program share: waiters, requests and stops, the status of
//! an axis, its outputs, the inputs of other devices. The files are those of the library; only `sync` is another.

#![allow(dead_code, unused_imports, reason = "the models use part of each file")]

pub(crate) use servocrab::{Failure, StopRequest};

mod axis;
mod bus;
mod models;
mod wakes;

/// What the shared files are made of.
mod sync {
    pub(crate) use loom::hint::spin_loop;
    pub(crate) use loom::sync::atomic::{
        AtomicBool, AtomicU8, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence,
    };
    pub(crate) use loom::sync::{Arc, Mutex, MutexGuard};

    /// That of `std`, which loom does not have: its state is loom's.
    pub(crate) struct OnceLock<T> {
        is_set: AtomicBool,
        value: std::sync::OnceLock<T>,
    }

    impl<T> OnceLock<T> {
        pub(crate) fn new() -> Self {
            Self {
                is_set: AtomicBool::new(false),
                value: std::sync::OnceLock::new(),
            }
        }

        pub(crate) fn get(&self) -> Option<&T> {
            let is_set = self.is_set.load(Ordering::Acquire);
            is_set.then(|| self.value.get()).flatten()
        }

        pub(crate) fn set(&self, value: T) -> Result<(), T> {
            self.value.set(value)?;
            self.is_set.store(true, Ordering::Release);
            Ok(())
        }
    }
}

mod coe {
    pub(crate) use servocrab::coe::{Number, ObjectAddress};
}

mod ds402 {
    pub(crate) use servocrab::ds402::{Controlword, Mode, State, Statusword};
}

mod pdo_map {
    pub(crate) use servocrab::pdo_map::{BitRange, Direction, Field, Layout};
}

fn main() {
    let mut models = 0;
    for (name, model) in models::ALL {
        let mut builder = loom::model::Builder::new();
        builder.preemption_bound = Some(3);
        builder.check(model);
        println!("{name}: no order of the threads breaks it");
        models += 1;
    }
    println!("{models} models");
}
