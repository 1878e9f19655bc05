"""Builder of the stand-in platform: program, flat binary and size; upload over heli-host flash.

Compiler and linker flags are not set here: they come from firmware/pio/flags.py, as with the real platform.
"""

from SCons.Script import AlwaysBuild, Builder, Default, DefaultEnvironment

env = DefaultEnvironment()
env.Replace(
    AR="arm-none-eabi-ar",
    AS="arm-none-eabi-as",
    CC="arm-none-eabi-gcc",
    CXX="arm-none-eabi-g++",
    OBJCOPY="arm-none-eabi-objcopy",
    RANLIB="arm-none-eabi-ranlib",
    SIZETOOL="arm-none-eabi-size",
    SIZEPROGREGEXP=r"^(?:\.text|\.data)\s+(\d+).*",
    SIZEDATAREGEXP=r"^(?:\.stack|\.data|\.bss)\s+(\d+).*",
    SIZECHECKCMD="$SIZETOOL -A -d $SOURCES",
    SIZEPRINTCMD="$SIZETOOL -B -d $SOURCES",
    PROGNAME="firmware",
    PROGSUFFIX=".elf",
    LINKFLAGS=[],
    # The same Python as PlatformIO's: both are installed into one environment.
    UPLOADER='"$PYTHONEXE" -c "from heli_host.ui.cli import main; main()" flash',
    UPLOADERFLAGS=["--yes", "--port", '"$UPLOAD_PORT"'],
    UPLOADCMD="$UPLOADER $UPLOADERFLAGS $SOURCES",
)
env.Append(BUILDERS={"ElfToBin": Builder(action="$OBJCOPY -O binary $SOURCES $TARGET", suffix=".bin")})

program = env.BuildProgram()
binary = env.ElfToBin("$BUILD_DIR/firmware", program)
AlwaysBuild(env.Alias("size", program, "$SIZEPRINTCMD"))
AlwaysBuild(env.Alias("upload", binary, [env.AutodetectUploadPort, "$UPLOADCMD"]))
Default([binary])
