// A shared library, opened: the system's own calls behind one name each.
#pragma once

#include <string>

#if defined(_WIN32)
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#else
#include <dlfcn.h>
#endif

namespace heli_sim {

#if defined(_WIN32)
inline void* open_library(const std::string& path) {
  return reinterpret_cast<void*>(LoadLibraryA(path.c_str()));
}
inline void* find_symbol(void* library, const std::string& name) {
  return reinterpret_cast<void*>(GetProcAddress(static_cast<HMODULE>(library), name.c_str()));
}
inline void close_library(void* library) { FreeLibrary(static_cast<HMODULE>(library)); }
inline std::string library_error() { return "error " + std::to_string(GetLastError()); }
#else
inline void* open_library(const std::string& path) {
  return dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
}
inline void* find_symbol(void* library, const std::string& name) {
  return dlsym(library, name.c_str());
}
inline void close_library(void* library) { dlclose(library); }
inline std::string library_error() { return dlerror(); }
#endif

}  // namespace heli_sim
