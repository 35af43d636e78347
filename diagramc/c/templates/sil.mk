# {{ first_line }}
# make test closes the loop in C and compares each step with the test vectors of both modules.
CFLAGS ?= {{ flags.usual | join(" ") }}
REQUIRED = {{ flags.required | join(" ") }}

# Each compiler has a folder of its own, such as build/gcc.
EMPTY =
BUILD = build/$(subst $(EMPTY) $(EMPTY),_,$(notdir $(CC)))
SOURCES = sil.c {{ sources | join(" ") }}

test: $(BUILD)/sil
	$(BUILD)/sil

$(BUILD)/sil: ALWAYS
	@mkdir -p $(BUILD)
	$(CC) $(REQUIRED) $(CFLAGS) {% for folder in folders %}-I{{ folder }} {% endfor %} -o $@ $(SOURCES) -lm

clean:
	rm -rf build

.PHONY: test clean ALWAYS
