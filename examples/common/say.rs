//! Lines on the standard output.

/// Prints a line. A reader that has gone away (`| head`) ends no machine in mid-move, as the panic of `println!` would.
macro_rules! say {
    ($($argument:tt)*) => {
        // Nobody is there to be told.
        let _ = std::io::Write::write_fmt(&mut std::io::stdout(), format_args!("{}\n", format_args!($($argument)*)));
    };
}
