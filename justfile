# Short names of the commands that this project uses. `just` is optional: each line is the command itself.

# the main job on the simulated rig
demo:
    cargo demo

# all tests
test:
    cargo test --workspace

# what must hold before a change is finished: tests, demo, format, lints, documentation
check:
    .ci/run

# what takes long: fuzzing, rates, a month with faults, the package in a container; without a part: the list
long *parts='--list':
    .ci/long {{parts}}

# the manual, as a book in target/book (cargo install mdbook --version 0.5.4 --locked)
docs:
    mdbook build docs

# write the generated reference pages anew
reference:
    TACTUS_WRITE_REFERENCE=1 cargo test -p tactus-tests --test stories manual::reference

# lines of source of each crate, without tests
lines:
    .ci/lines
