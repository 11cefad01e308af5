//! Runs this program under valgrind's callgrind and reads what it wrote.

use std::{
    collections::BTreeMap,
    env, fs,
    path::Path,
    process::{Command, Stdio},
};

/// Instructions by function, between two dumps.
pub(crate) struct Dump {
    own: BTreeMap<String, u64>,
    /// From caller to callee, the callee's own calls included.
    calls: BTreeMap<(String, String), u64>,
}

pub(crate) fn is_there() -> bool {
    Command::new("valgrind")
        .arg("--version")
        .stdout(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

/// Runs this program with these arguments; a dump from each call of a function with `counting_begins` in its
/// name to the next of one with `counting_ends`.
pub(crate) fn run(directory: &Path, arguments: &[&str]) -> Vec<Dump> {
    let _ = fs::remove_dir_all(directory);
    fs::create_dir_all(directory).expect("the target directory can be written");
    let output = Command::new("valgrind")
        .arg("--tool=callgrind")
        .arg("--zero-before=*counting_begins*")
        .arg("--dump-before=*counting_ends*")
        .arg(format!(
            "--callgrind-out-file={}",
            directory.join("out").display()
        ))
        .arg(env::current_exe().expect("this program has a path"))
        .args(arguments)
        .output()
        .expect("valgrind starts");
    assert!(
        output.status.success(),
        "{}\n{}{}",
        output.status,
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    (1..)
        .map(|number| directory.join(format!("out.{number}")))
        .map_while(|file| fs::read_to_string(file).ok())
        // The last one is of the end of the program.
        .filter(|text| !text.contains("Trigger: Program termination"))
        .map(|text| Dump::read(&text))
        .collect()
}

impl Dump {
    /// Callgrind's profile format, of one event. Names are written once and numbered.
    fn read(text: &str) -> Self {
        let mut names: BTreeMap<String, String> = BTreeMap::new();
        let mut name_of = |text: &str| match text.split_once(' ') {
            Some((number, name)) => {
                names.insert(number.to_owned(), name.to_owned());
                name.to_owned()
            }
            None => names[text].clone(),
        };
        let mut dump = Self {
            own: BTreeMap::new(),
            calls: BTreeMap::new(),
        };
        let (mut function, mut callee, mut call) = (String::new(), String::new(), false);
        for line in text.lines() {
            if let Some(name) = line.strip_prefix("fn=") {
                function = name_of(name);
            } else if let Some(name) = line.strip_prefix("cfn=") {
                callee = name_of(name);
            } else if line.starts_with("calls=") {
                call = true;
            } else if line
                .starts_with(|first: char| first.is_ascii_digit() || "+-*".contains(first))
            {
                let cost = line
                    .split(' ')
                    .nth(1)
                    .map_or(0, |cost| cost.parse().expect("a number"));
                if core::mem::take(&mut call) {
                    *dump
                        .calls
                        .entry((function.clone(), callee.clone()))
                        .or_default() += cost;
                } else {
                    *dump.own.entry(function.clone()).or_default() += cost;
                }
            }
        }
        dump
    }

    /// Of the functions whose names begin with `inside`, called by others, without those that have `outside` in their
    /// names, wherever they are called on the way.
    pub(crate) fn between(&self, inside: &str, outside: &str) -> u64 {
        let within: u64 = self
            .calls
            .iter()
            .filter(|((caller, callee), _)| {
                callee.starts_with(inside) && !caller.starts_with(inside)
            })
            .map(|(_, cost)| cost)
            .sum();
        let reached = self.reached(inside, outside);
        let without: u64 = self
            .calls
            .iter()
            .filter(|((caller, callee), _)| reached.contains(caller) && callee.contains(outside))
            .map(|(_, cost)| cost)
            .sum();
        assert!(within > without && without > 0, "{inside} is in no profile");
        within - without
    }

    /// What each function that counts takes itself.
    pub(crate) fn print(&self, times: usize) {
        let reached = self.reached("servocrab::bus::cycle::Cycle::", "Outside");
        let mut own: Vec<_> = reached
            .iter()
            .map(|name| (self.own.get(name).copied().unwrap_or(0), name))
            .collect();
        own.sort();
        for (cost, name) in own
            .iter()
            .rev()
            .filter(|(cost, _)| *cost as f64 / times as f64 > 0.5)
        {
            println!("{:10.1}  {name}", *cost as f64 / times as f64);
        }
    }

    fn reached(&self, inside: &str, outside: &str) -> Vec<String> {
        let mut reached: Vec<String> = self
            .own
            .keys()
            .filter(|name| name.starts_with(inside))
            .cloned()
            .collect();
        let mut next = 0;
        while let Some(name) = reached.get(next).cloned() {
            next += 1;
            for (caller, callee) in self.calls.keys() {
                if *caller == name && !callee.contains(outside) && !reached.contains(callee) {
                    reached.push(callee.clone());
                }
            }
        }
        reached
    }
}
