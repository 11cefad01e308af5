//! The programs of this bench, as the main one talks to them.

use std::{
    io::{BufRead, BufReader, Write},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};

use crate::{
    measure::{Measured, Mode},
    namespace::Process,
};

/// A process that answers each line with a line.
pub(crate) struct Talk {
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    /// Ends with its owner.
    _process: Process,
}

impl Talk {
    /// Starts it and waits until it is ready.
    pub(crate) fn start(command: &mut Command) -> Self {
        let mut child: Child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut talk = Self {
            to: child.stdin.take().expect("piped"),
            from: BufReader::new(child.stdout.take().expect("piped")),
            _process: Process(child),
        };
        assert_eq!(talk.hear(), "ready", "{command:?}");
        talk
    }

    fn hear(&mut self) -> String {
        let mut line = String::new();
        self.from.read_line(&mut line).expect("text");
        line.trim().to_owned()
    }

    pub(crate) fn ask(&mut self, order: &str) -> String {
        writeln!(self.to, "{order}").expect("it listens");
        self.hear()
    }

    pub(crate) fn measure(&mut self, mode: Mode, cycles: usize) -> Measured {
        let all = self.measure_all(&format!("{} {cycles}", mode.name()));
        *all.first().expect("one")
    }

    pub(crate) fn measure_all(&mut self, order: &str) -> Vec<Measured> {
        let said = self.ask(order);
        let values: Vec<f64> = said
            .split(' ')
            .map(|text| text.parse().unwrap_or_else(|_| panic!("{said:?}")))
            .collect();
        let (all, []) = values.as_chunks::<5>() else {
            panic!("{said:?}");
        };
        all.iter()
            .map(|values| Measured::from_values(*values))
            .collect()
    }
}
