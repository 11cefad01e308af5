//! One axis: the pure core and the handle that users hold.
